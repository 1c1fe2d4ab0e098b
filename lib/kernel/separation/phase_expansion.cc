// SPDX-License-Identifier: GPL-3.0-or-later
#include "phase_expansion.h"

#include "../algebra/complex_rows.h"
#include "../algebra/matrix_product.h"
#include "../algebra/symmetric.h"
#include "../clones.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

namespace gr::wiforce::kernel {

namespace {

using complex = std::complex<double>;

// Part of its own information that a phase is left by the others, below which all are
// taken together.
constexpr double negligible = 1e-9;

} // namespace

phase_expansion::phase_expansion(const end_fit& fit)
    : sizes(fit.sizes),
      d_ends(fit.ends),
      d_gram(sizes.groups * sizes.ends * sizes.ends),
      d_gradient(sizes.groups * tags() * sizes.subcarriers),
      d_excess(sizes.groups * tags())
{
    expand(fit);
}

WIFORCE_CLONES
void phase_expansion::expand(const end_fit& fit)
{
    const auto [groups, tones, ends, subcarriers] = sizes;
    std::vector<double> moved(ends * ends), changes(tones * ends), packed;
    std::vector<complex> along(ends * subcarriers);
    for (std::size_t group = 0; group < groups; group++) {
        const double* const solver = fit.solver.data() + group * ends * tones;
        const double* const mixing = fit.mixing.data() + group * tones * ends;
        const double* const slopes = fit.slopes.data() + group * tones * ends;
        // By what the ends change, and what the tones then still do; a column per end.
        std::fill(moved.begin(), moved.end(), 0.0);
        add_product(
            { solver, tones, 1 }, ends, tones, slopes, ends, moved.data(), packed);
        std::copy_n(slopes, changes.size(), changes.begin());
        add_product({ mixing, ends, 1, -1 },
                    tones,
                    ends,
                    moved.data(),
                    ends,
                    changes.data(),
                    packed);
        double* const gram = d_gram.data() + group * ends * ends;
        const left_factor changed{ changes.data(), 1, ends };
        add_product(changed, ends, tones, changes.data(), ends, gram, packed);
        for (std::size_t row = 0; row < ends; row++)
            for (std::size_t column = row / 2 * 2; column < row / 2 * 2 + 2; column++)
                d_excess[group * tags() + row / 2] +=
                    2 * subcarriers * gram[row * ends + column] *
                    std::inner_product(solver + row * tones,
                                       solver + (row + 1) * tones,
                                       solver + column * tones,
                                       0.0);
        std::fill(along.begin(), along.end(), 0.0);
        add_product(changed,
                    ends,
                    tones,
                    &fit.residual[group * tones * subcarriers],
                    subcarriers,
                    along.data(),
                    packed);
        for (std::size_t end = 0; end < ends; end++) {
            const complex* const channel = &d_ends[(group * ends + end) * subcarriers];
            double* const gradient =
                &d_gradient[(group * tags() + end / 2) * subcarriers];
            for (std::size_t k = 0; k < subcarriers; k++)
                gradient[k] += 2 * real_product(channel[k], along[end * subcarriers + k]);
        }
    }
}

WIFORCE_CLONES
phase_expansion::information phase_expansion::informed(const double* inverse_noise) const
{
    const std::size_t ends = sizes.ends, subcarriers = sizes.subcarriers;
    information found{ std::vector<double>(sizes.groups * tags()),
                       std::vector<double>(sizes.groups * tags() * tags()),
                       d_excess };
    std::vector<complex> weighted(subcarriers);
    for (std::size_t group = 0; group < sizes.groups; group++) {
        for (std::size_t tag = 0; tag < tags(); tag++)
            for (std::size_t k = 0; k < subcarriers; k++)
                found.gradient[group * tags() + tag] +=
                    d_gradient[(group * tags() + tag) * subcarriers + k] *
                    inverse_noise[k];
        for (std::size_t row = 0; row < ends; row++) {
            const complex* const own = &d_ends[(group * ends + row) * subcarriers];
            for (std::size_t k = 0; k < subcarriers; k++)
                weighted[k] = own[k] * inverse_noise[k];
            for (std::size_t column = row; column < ends; column++) {
                const complex* const other =
                    &d_ends[(group * ends + column) * subcarriers];
                double product = 0;
                for (std::size_t k = 0; k < subcarriers; k++)
                    product += real_product(weighted[k], other[k]);
                product *= 2 * d_gram[(group * ends + row) * ends + column];
                found.expected[(group * tags() + row / 2) * tags() + column / 2] +=
                    product;
                if (column > row)
                    found.expected[(group * tags() + column / 2) * tags() + row / 2] +=
                        product;
            }
        }
        for (std::size_t tag = 0; tag < tags(); tag++)
            found.expected[(group * tags() + tag) * tags() + tag] -=
                d_excess[group * tags() + tag];
    }
    return found;
}

std::vector<clock_tracker::measurement>
phase_errors(const phase_expansion::information& of)
{
    const std::size_t count = of.gradient.size();
    std::vector<clock_tracker::measurement> errors(
        count, { 0.0, std::numeric_limits<double>::infinity() });
    std::vector<double> scale(count);
    for (std::size_t i = 0; i < count; i++) {
        const double own = of.expected[i * count + i];
        if (!(own > 0))
            return errors;
        scale[i] = 1 / std::sqrt(own);
    }
    auto inverse = of.expected;
    for (std::size_t i = 0; i < inverse.size(); i++)
        inverse[i] *= scale[i / count] * scale[i % count];
    inverse = inverse_of(inverse, count, 1 / negligible);
    for (std::size_t i = 0; i < inverse.size(); i++)
        inverse[i] *= scale[i / count] * scale[i % count];
    for (std::size_t row = 0; row < count; row++) {
        const double* const own = &inverse[row * count];
        double error = 0, variance = 0;
        // The diagonal of inverse x (expected + excess) x inverse.
        for (std::size_t i = 0; i < count; i++) {
            double product = own[i] * of.excess[i];
            for (std::size_t j = 0; j < count; j++)
                product += own[j] * of.expected[j * count + i];
            error += own[i] * of.gradient[i];
            variance += product * own[i];
        }
        errors[row] = { error, variance };
    }
    return errors;
}

} // namespace gr::wiforce::kernel
