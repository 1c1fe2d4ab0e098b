// SPDX-License-Identifier: GPL-3.0-or-later
// Products of small matrices, in tiles whose sums stay in registers: a sum in memory
// costs a load and a store for each product. The left factor is real; complex columns of
// the right one are two real ones. For functions with WIFORCE_CLONES, into which all of
// it is inlined. Also sums over rows of complex numbers, written in real ones, which
// compilers vectorise.
#pragma once

#include "../types.h"

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <vector>

namespace gr::wiforce::kernel {

// The left factor of a product, `rows` x `depth`: its elements at `row` and `column`
// distances, times `sign`, and whether it is lower triangular.
struct left_factor {
    const double* values;
    std::size_t rows, depth, row = depth, column = 1;
    double sign = 1;
    bool triangular = false;
};

namespace tiles {

constexpr std::size_t rows = 4, vectors = 2; // of a tile: 8 sums, as registers allow
using four = double __attribute__((vector_size(32)));

// to += factors x from, of Rows rows and Vectors times four columns.
template <std::size_t Rows, std::size_t Vectors>
inline __attribute__((always_inline)) void add_tile(const double* factors,
                                                    std::size_t depth,
                                                    const double* from,
                                                    std::size_t columns,
                                                    double* to)
{
    four sums[Rows][Vectors]{};
    for (std::size_t i = 0; i < depth; i++, factors += rows, from += columns)
        for (std::size_t v = 0; v < Vectors; v++) {
            four values;
            std::memcpy(&values, from + 4 * v, sizeof values);
            for (std::size_t row = 0; row < Rows; row++)
                sums[row][v] += factors[row] * values;
        }
    for (std::size_t row = 0; row < Rows; row++, to += columns)
        for (std::size_t v = 0; v < Vectors; v++)
            for (std::size_t i = 0; i < 4; i++)
                to[4 * v + i] += sums[row][v][i];
}

template <std::size_t Rows>
inline __attribute__((always_inline)) void add_rows(const double* factors,
                                                    std::size_t depth,
                                                    const double* from,
                                                    std::size_t columns,
                                                    double* to)
{
    std::size_t column = 0;
    for (; column + 4 * vectors <= columns; column += 4 * vectors)
        add_tile<Rows, vectors>(factors, depth, from + column, columns, to + column);
    for (; column + 4 <= columns; column += 4)
        add_tile<Rows, 1>(factors, depth, from + column, columns, to + column);
    for (; column < columns; column++)
        for (std::size_t row = 0; row < Rows; row++) {
            double sum = 0;
            for (std::size_t i = 0; i < depth; i++)
                sum += factors[i * rows + row] * from[i * columns + column];
            to[row * columns + column] += sum;
        }
}

} // namespace tiles

// to += left x right, `columns` columns of double or complex, row by row.
template <class T>
inline __attribute__((always_inline)) void
add_product(const left_factor& left, const T* right, std::size_t columns, T* to)
{
    const auto* const from = reinterpret_cast<const double*>(right);
    columns *= sizeof(T) / sizeof(double);
    std::vector<double> packed(tiles::rows * left.depth);
    for (std::size_t row = 0; row < left.rows;) {
        const std::size_t rest = left.rows - row;
        const std::size_t rows = rest >= tiles::rows ? tiles::rows : rest >= 2 ? 2 : 1;
        const std::size_t depth =
            left.triangular ? std::min(left.depth, row + rows) : left.depth;
        for (std::size_t i = 0; i < depth; i++)
            for (std::size_t each = 0; each < rows; each++)
                packed[i * tiles::rows + each] =
                    left.sign * left.values[(row + each) * left.row + i * left.column];
        double* const sums = reinterpret_cast<double*>(to) + row * columns;
        if (rows == tiles::rows)
            tiles::add_rows<tiles::rows>(packed.data(), depth, from, columns, sums);
        else if (rows == 2)
            tiles::add_rows<2>(packed.data(), depth, from, columns, sums);
        else
            tiles::add_rows<1>(packed.data(), depth, from, columns, sums);
        row += rows;
    }
}

// Real part of conj(first) x second.
inline double real_product(complex first, complex second)
{
    return first.real() * second.real() + first.imag() * second.imag();
}

// sum += factor x row
inline void
add_scaled(complex factor, const complex* row, std::size_t count, complex* sum)
{
    const double real = factor.real(), imag = factor.imag();
    const auto* const from = reinterpret_cast<const double*>(row);
    auto* const to = reinterpret_cast<double*>(sum);
    for (std::size_t i = 0; i < 2 * count; i += 2) {
        const double x = from[i], y = from[i + 1];
        to[i] += real * x - imag * y;
        to[i + 1] += real * y + imag * x;
    }
}

// Sum of |row|^2, in sums that do not wait for each other.
inline __attribute__((always_inline)) double power_of(const complex* row,
                                                      std::size_t count)
{
    const auto* const values = reinterpret_cast<const double*>(row);
    tiles::four sums[4]{};
    std::size_t i = 0;
    for (; i + 16 <= 2 * count; i += 16)
        for (std::size_t j = 0; j < 4; j++) {
            tiles::four next;
            std::memcpy(&next, values + i + 4 * j, sizeof next);
            sums[j] += next * next;
        }
    const tiles::four all = (sums[0] + sums[1]) + (sums[2] + sums[3]);
    double sum = (all[0] + all[1]) + (all[2] + all[3]);
    for (; i < 2 * count; i++)
        sum += values[i] * values[i];
    return sum;
}

} // namespace gr::wiforce::kernel
