// SPDX-License-Identifier: GPL-3.0-or-later
#include "likelihood_profile.h"

#include "../require.h"
#include "hidden_force.h"
#include "normal_integrals.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

namespace gr::wiforce::kernel {

namespace {

// Segments this much less likely than the best (squared standard deviations) do not
// count.
constexpr double negligible = 40.0;
// A dip of the likelihood by so much parts two solutions.
constexpr double barrier = 4.0;
constexpr double least_variance = 1e-12;

// Built for several instruction sets, of which the processor's is chosen when the library
// is loaded: tests see that one. Sanitizers cannot be asked that early.
#if defined(WIFORCE_X86) && defined(__gnu_linux__) && !defined(__SANITIZE_THREAD__) &&   \
    !defined(__SANITIZE_ADDRESS__)
#define WIFORCE_CLONES __attribute__((target_clones("avx512f", "avx2", "default")))
#else
#define WIFORCE_CLONES
#endif
// Part of a function that is built so.
#define WIFORCE_INLINE [[gnu::always_inline]] inline

// Of the solution `mean`; about it, so that the standard deviation reaches the others.
likelihood_profile::reading summary(const likelihood_profile::moments& all,
                                    const likelihood_profile::moments& mean,
                                    bool ambiguous,
                                    double misfit)
{
    constexpr double least_mass = std::numeric_limits<double>::min();
    const double mass = std::max(all.mass, least_mass),
                 mean_by = std::max(mean.mass, least_mass);
    const double f = mean.force / mean_by, l = mean.place / mean_by;
    return {
        f,
        l,
        std::max(all.force_2 / mass - 2 * f * all.force / mass + f * f, least_variance),
        std::max(all.place_2 / mass - 2 * l * all.place / mass + l * l, least_variance),
        all.product / mass - f * all.place / mass - l * all.force / mass + f * l,
        misfit,
        all.hidden / mass,
        all.outside / mass,
        ambiguous ? 1.0 : 0.0
    };
}

// Least z^2 on a segment.
double least_square(double a, double b)
{
    return a * b <= 0 ? 0.0 : std::min(a * a, b * b);
}

} // namespace

likelihood_profile::likelihood_profile(std::vector<double> force,
                                       std::vector<float> rows,
                                       const std::vector<std::uint8_t>& holds,
                                       std::vector<cell> cells)
    : d_force(std::move(force)),
      d_rows(std::move(rows)),
      d_closed(holds.size()),
      d_cells(std::move(cells)),
      d_grid(d_cells.size())
{
    const std::string where = "likelihood_profile";
    require(d_force.size() >= 2 && d_force.size() <= most_nodes,
            where,
            "force",
            "must have 2 to 32 nodes",
            d_force.size());
    const auto size = d_force.size() * columns;
    require(d_rows.size() % size == 0,
            where,
            "rows",
            "must have columns x nodes numbers each",
            d_rows.size());
    require(holds.size() == this->rows() * (d_force.size() - 1),
            where,
            "holds",
            "must have a value for each segment of each row",
            holds.size());
    require(!d_cells.empty() && d_grid.total() == d_cells.size(),
            where,
            "cells",
            "must be square",
            d_cells.size());
    for (const auto& c : d_cells)
        require(c.first >= 0 && c.count >= 0 && c.count <= 2 &&
                    static_cast<std::size_t>(c.first) + c.count <= this->rows(),
                where,
                "cells",
                "must name up to two rows that there are",
                c.first);
    const float infinity = std::numeric_limits<float>::infinity();
    std::transform(holds.begin(), holds.end(), d_closed.begin(), [&](std::uint8_t open) {
        return open ? 0.0F : infinity;
    });
}

void likelihood_profile::moments::operator+=(const moments& other)
{
    mass += other.mass;
    force += other.force;
    force_2 += other.force_2;
    place += other.place;
    place_2 += other.place_2;
    product += other.product;
    hidden += other.hidden;
    outside += other.outside;
}

std::size_t likelihood_profile::rows() const
{
    return d_rows.size() / (columns * d_force.size());
}

likelihood_profile::turns likelihood_profile::read_turns(double psi_1,
                                                         double psi_2,
                                                         double noise_1,
                                                         double noise_2) const
{
    const auto place = d_grid.locate(psi_1, psi_2);
    const auto [row, count] = d_cells[place.cell];
    turns found{ count, {}, {} };
    if (count > 0)
        found.first = read(row, place.offset_1, place.offset_2, noise_1, noise_2);
    if (count > 1)
        found.second = read(row + 1, place.offset_1, place.offset_2, noise_1, noise_2);
    return found;
}

WIFORCE_INLINE likelihood_profile::curve likelihood_profile::draw(std::size_t row,
                                                                  double offset_1,
                                                                  double offset_2,
                                                                  double noise_1,
                                                                  double noise_2) const
{
    const auto count = d_force.size();
    const float* const values = &d_rows[row * columns * count];
    curve drawn;
    for (std::size_t k = 0; k < count; k++) {
        const double e1 = values[error_1 * count + k] + offset_1,
                     e2 = values[error_2 * count + k] + offset_2;
        const double s1 = values[slope_1 * count + k], s2 = values[slope_2 * count + k];
        const double v1 = values[variance_1 * count + k] + noise_1,
                     v2 = values[variance_2 * count + k] + noise_2;
        const double total = s1 * s1 * v2 + s2 * s2 * v1 + least_variance;
        const double scale = 1 / std::sqrt(total), square = scale * scale;
        drawn.z[k] = (s2 * e1 - s1 * e2) * scale;
        drawn.place[k] =
            values[place * count + k] + (s1 * v2 * e1 + s2 * v1 * e2) * square;
        drawn.width[k] = v1 * v2 * square;
        drawn.scale[k] = scale;
    }
    const float* const closed = &d_closed[row * (count - 1)];
    for (std::size_t k = 0; k + 1 < count; k++)
        drawn.misfit[k] = least_square(drawn.z[k], drawn.z[k + 1]) + closed[k];
    double best = drawn.misfit[0];
    for (std::size_t k = 1; k + 1 < count; k++)
        best = std::min(best, drawn.misfit[k]);
    drawn.best = best;
    return drawn;
}

WIFORCE_INLINE likelihood_profile::weights
likelihood_profile::weigh(const curve& drawn, std::size_t low, std::size_t high) const
{
    static const normal_integral cumulated;
    const auto& z = drawn.z;
    column_values density;
    densities(&z[low], high + 1 - low, &density[low]);
    weights found;
    const auto take = [&](std::size_t k, const integrals& part) {
        const double counts = drawn.misfit[k] < drawn.best + negligible;
        const double scale = counts * (d_force[k + 1] - d_force[k]) *
                             (drawn.scale[k] + drawn.scale[k + 1]);
        found.left[k] = scale * (part.zeroth - part.first);
        found.right[k] = scale * part.first;
        found.bend[k] = scale * (part.first - part.second);
    };
    for (std::size_t k = low; k < high; k++)
        take(k, of_polynomial(z[k], z[k + 1], density[k], density[k + 1]));
    for (std::size_t k = low; k < high; k++)
        if (std::abs(z[k + 1] - z[k]) > small_step)
            take(k,
                 by_parts(z[k],
                          z[k + 1],
                          density[k],
                          density[k + 1],
                          cumulated(z[k + 1]) - cumulated(z[k])));
    return found;
}

WIFORCE_INLINE likelihood_profile::moments
likelihood_profile::sum(const float* values,
                        const curve& drawn,
                        const weights& by,
                        std::size_t first,
                        std::size_t last,
                        double hidden_from) const
{
    const auto count = d_force.size();
    const float *const free_n = values + free * count, *const in =
                                                           values + inside * count;
    const auto *const force = d_force.data(), *const place = drawn.place.data();
    moments sums;
    for (std::size_t k = first; k < last; k++) {
        const double a = by.left[k], b = by.right[k], bend = by.bend[k], mass = a + b;
        const double f_a = force[k], f_b = force[k + 1], step = f_b - f_a;
        const double l_a = place[k], l_b = place[k + 1], rise = l_b - l_a;
        sums.mass += mass;
        sums.force += a * f_a + b * f_b;
        sums.force_2 += a * f_a * f_a + b * f_b * f_b - bend * step * step;
        sums.place += a * l_a + b * l_b;
        sums.place_2 += a * (l_a * l_a + drawn.width[k]) +
                        b * (l_b * l_b + drawn.width[k + 1]) - bend * rise * rise;
        sums.product += a * f_a * l_a + b * f_b * l_b - bend * step * rise;
        sums.hidden += free_n[k] > hidden_from ? mass : 0.0;
        sums.outside += mass * (1 - in[k] * in[k + 1]);
    }
    return sums;
}

WIFORCE_CLONES
likelihood_profile::reading likelihood_profile::read(std::size_t row,
                                                     double offset_1,
                                                     double offset_2,
                                                     double noise_1,
                                                     double noise_2) const
{
    const auto drawn = draw(row, offset_1, offset_2, noise_1, noise_2);
    if (!std::isfinite(drawn.best))
        return { NAN, NAN, NAN, NAN, NAN, drawn.best, 0, 0, 0 };

    const auto count = d_force.size();
    // Runs of likely segments are solutions; what lies between belongs to the run before.
    std::array<std::size_t, most_nodes> starts;
    std::size_t runs = 0, low = count, high = 0; // of segments that count
    bool likely_before = false;
    for (std::size_t k = 0; k + 1 < count; k++) {
        const bool likely = drawn.misfit[k] < drawn.best + barrier;
        if (likely && !likely_before)
            starts[runs++] = k;
        likely_before = likely;
        if (drawn.misfit[k] < drawn.best + negligible) {
            low = std::min(low, k);
            high = k + 1;
        }
    }
    const auto by = weigh(drawn, low, high);
    starts[0] = low;
    starts[runs] = high;
    const double hidden_from = hidden_n / std::sqrt(std::max({ noise_1, noise_2, 1.0 }));
    const float* const values = &d_rows[row * columns * count];
    moments all, chosen;
    double chosen_worth = -1;
    for (std::size_t run = 0; run < runs; run++) {
        const auto sums =
            sum(values, drawn, by, starts[run], starts[run + 1], hidden_from);
        all += sums;
        // the calibrated span decides between solutions that fit alike
        const double inside_mass = sums.mass - sums.outside;
        const double worth =
            inside_mass > 1e-3 * sums.mass ? inside_mass : 1e-9 * sums.mass;
        if (worth > chosen_worth) {
            chosen = sums;
            chosen_worth = worth;
        }
    }
    return summary(all, chosen, runs > 1, drawn.best);
}

} // namespace gr::wiforce::kernel
