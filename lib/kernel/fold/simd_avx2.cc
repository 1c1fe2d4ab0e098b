// SPDX-License-Identifier: GPL-3.0-or-later
#define WIFORCE_SIMD avx2
#define WIFORCE_SIMD_NAME "avx2"
#define WIFORCE_LANES 8
#include "simd_loops.h"
