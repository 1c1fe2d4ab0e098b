// SPDX-License-Identifier: GPL-3.0-or-later
#define WIFORCE_SIMD generic
#define WIFORCE_SIMD_NAME "generic"
#define WIFORCE_LANES 4
#include "simd_loops.h"
