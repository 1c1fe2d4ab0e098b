// SPDX-License-Identifier: GPL-3.0-or-later
// Plain kernels for NumPy: nothing here needs GNU Radio's runtime.
#include "../refusal.h"
#include "kernels.h"

PYBIND11_MODULE(wiforce_kernels, m)
{
    pybind11::register_local_exception_translator(translate_refusal);
    bind_inversion(m);
    bind_press(m);
    bind_recordings(m);
    bind_screening(m);
    bind_separation(m);
    bind_termination(m);
    bind_timing(m);
    bind_tones(m);
}
