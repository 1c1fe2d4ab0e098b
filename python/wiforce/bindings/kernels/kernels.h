// SPDX-License-Identifier: GPL-3.0-or-later
// The parts of the module wiforce_kernels, and how they exchange arrays.
// Docstrings state shapes; the headers in lib/kernel/ state the rest.
#pragma once

#include <pybind11/complex.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cstring>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

namespace py = pybind11;
using namespace py::literals;

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

template <class T>
py::array_t<T> copy(const std::vector<T>& values, const shape& of)
{
    return py::array_t<T>(of, values.data());
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
