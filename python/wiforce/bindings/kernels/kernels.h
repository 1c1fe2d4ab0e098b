// SPDX-License-Identifier: GPL-3.0-or-later
// The parts of the module wiforce_kernels, and how they exchange arrays.
// Docstrings state shapes; the headers in lib/kernel/ state the rest.
#pragma once

#include <pybind11/complex.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <exception>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

namespace py = pybind11;
using namespace py::literals;

// A refused parameter is bad input, as Python code raises it: errors.InputError.
inline void translate_refusal(std::exception_ptr thrown)
{
    try {
        std::rethrow_exception(thrown);
    } catch (const std::invalid_argument& refusal) {
        const auto type =
            py::module::import("gnuradio.wiforce.errors").attr("InputError");
        const py::object error = type.attr("__new__")(type, refusal.what());
        PyErr_SetObject(type.ptr(), error.ptr());
    }
}

void bind_inversion(py::module& m);
void bind_phases(py::module& m);
void bind_press(py::module& m);
void bind_recordings(py::module& m);
void bind_separation(py::module& m);
void bind_tones(py::module& m);

// Any array of numbers, row by row.
template <class T>
using array = py::array_t<T, py::array::c_style | py::array::forcecast>;

using complex_array = array<std::complex<double>>;
using shape = std::vector<py::ssize_t>;

template <class T>
void require_shape(const array<T>& values, const shape& wanted, const char* rule)
{
    if (shape(values.shape(), values.shape() + values.ndim()) != wanted)
        throw std::invalid_argument(rule);
}

// Sizes of an array of N dimensions.
template <std::size_t N, class T>
std::array<py::ssize_t, N> sizes_of(const array<T>& values, const char* rule)
{
    if (values.ndim() != N)
        throw std::invalid_argument(rule);
    std::array<py::ssize_t, N> sizes;
    std::copy_n(values.shape(), N, sizes.begin());
    return sizes;
}

template <class T>
py::array_t<T> copy(const std::vector<T>& values, const shape& of)
{
    return py::array_t<T>(of, values.data());
}

template <class T>
py::array_t<T> copy(const std::vector<T>& values)
{
    return py::array_t<T>(values.size(), values.data());
}

template <class T>
std::vector<T> flat(const array<T>& values)
{
    return { values.data(), values.data() + values.size() };
}

// Rows of numbers as structures of the same size.
template <class Row, class T>
std::vector<Row> structures(const array<T>& values)
{
    static_assert(std::is_trivially_copyable_v<Row> && sizeof(Row) % sizeof(T) == 0);
    std::vector<Row> rows(values.size() * sizeof(T) / sizeof(Row));
    if (rows.size() * sizeof(Row) != values.size() * sizeof(T))
        throw std::invalid_argument("rows must have " +
                                    std::to_string(sizeof(Row) / sizeof(T)) + " columns");
    if (!rows.empty())
        std::memcpy(rows.data(), values.data(), rows.size() * sizeof(Row));
    return rows;
}

// Snapshots of the weights of tones.
inline int columns_of(const complex_array& weights)
{
    if (weights.ndim() != 2)
        throw std::invalid_argument(
            "weights must have 2 dimensions, tones x snapshots, got " +
            std::to_string(weights.ndim()));
    return weights.shape(1);
}
