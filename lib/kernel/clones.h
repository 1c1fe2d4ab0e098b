// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

// Before a function: it is built for several instruction sets, of which the processor's
// is chosen when the library is loaded. Sanitizers cannot be asked that early, and Clang
// 14 gives the function another name than the one that other source files call.
#if defined(WIFORCE_X86) && defined(__gnu_linux__) && !defined(__clang__) &&             \
    !defined(__SANITIZE_THREAD__) && !defined(__SANITIZE_ADDRESS__)
#if __GNUC__ >= 12 // with fused multiplication and addition
#define WIFORCE_CLONES                                                                   \
    __attribute__((target_clones("avx512f", "arch=x86-64-v3", "default")))
#else
#define WIFORCE_CLONES __attribute__((target_clones("avx512f", "avx2", "default")))
#endif
#else
#define WIFORCE_CLONES
#endif
