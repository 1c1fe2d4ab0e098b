// SPDX-License-Identifier: GPL-3.0-or-later
#define WIFORCE_SIMD avx512
#define WIFORCE_SIMD_NAME "avx512"
#define WIFORCE_LANES 16
#include "simd_loops.h"
