// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <pybind11/pybind11.h>

#include <stdexcept>

// A refused parameter is bad input, as Python code raises it: errors.InputError.
inline void translate_refusal(std::exception_ptr thrown)
{
    try {
        std::rethrow_exception(thrown);
    } catch (const std::invalid_argument& refusal) {
        const auto type =
            pybind11::module::import("gnuradio.wiforce.errors").attr("InputError");
        const pybind11::object error = type.attr("__new__")(type, refusal.what());
        PyErr_SetObject(type.ptr(), error.ptr());
    }
}
