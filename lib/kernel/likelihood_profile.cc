// SPDX-License-Identifier: GPL-3.0-or-later
#include "likelihood_profile.h"

#include "require.h"

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
// Below this step of z the closed forms lose digits, and straight lines serve.
constexpr double small_step = 0.1;
// Force is hidden where a phase error of 1 deg, or of the reading's own size, costs this
// much.
constexpr double hidden_n = 0.5;
constexpr double least_variance = 1e-12;

// exp(-z^2 / 2) and its integral from 0, by Taylor steps from a table: an error below
// 1e-9.
class normal
{
public:
    struct values {
        double density, cumulated;
    };

    normal()
    {
        for (std::size_t i = 0; i < d_at.size(); i++) {
            const double z = static_cast<double>(i) / per_unit;
            d_at[i] = { std::exp(-0.5 * z * z),
                        std::sqrt(M_PI / 2) * std::erf(std::sqrt(0.5) * z) };
        }
    }

    values operator()(double z) const
    {
        const double x = std::min(std::abs(z), largest);
        const auto i = static_cast<std::size_t>(x * per_unit + 0.5);
        const double a = static_cast<double>(i) / per_unit, h = x - a,
                     density = d_at[i].density;
        // derivatives of the density are Hermite polynomials times it
        const double second = (a * a - 1) / 2, third = a * (3 - a * a) / 6,
                     fourth = ((a * a - 6) * a * a + 3) / 24;
        const double change = 1 + h * (-a + h * (second + h * (third + h * fourth)));
        const double mean =
            1 + h * (-a / 2 + h * (second / 3 + h * (third / 4 + h * fourth / 5)));
        const double cumulated = d_at[i].cumulated + h * density * mean;
        return { density * change, z < 0 ? -cumulated : cumulated };
    }

private:
    static constexpr double largest = 40.0;
    static constexpr int per_unit = 32;
    std::vector<values> d_at = std::vector<values>(40 * per_unit + 1);
};

struct node {
    double z, place, width, scale;
    double density, cumulated; // of the likelihood at z and from 0 to z

    void evaluate()
    {
        static const normal table;
        const auto found = table(z);
        density = found.density;
        cumulated = found.cumulated;
    }
};

// Sums of the likelihood times powers of force and location.
struct moments {
    double mass = 0, force = 0, force_2 = 0, place = 0, place_2 = 0, product = 0;
    double hidden = 0, outside = 0;

    void operator+=(const moments& other)
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
};

// Integrals of t^0, t^1, t^2 times exp(-z^2 / 2), z from a to b while t goes from 0 to 1.
struct integrals {
    double zeroth, first, second;

    integrals(const node& a, const node& b)
    {
        const double step = b.z - a.z;
        if (std::abs(step) < small_step) {
            zeroth = (a.density + b.density) / 2;
            first = a.density / 6 + b.density / 3;
            second = a.density / 12 + b.density / 4;
            return;
        }
        const double per_step = 1 / step;
        zeroth = (b.cumulated - a.cumulated) * per_step;
        // by parts
        first = ((a.density - b.density) * per_step - a.z * zeroth) * per_step;
        second = ((zeroth - b.density) * per_step - a.z * first) * per_step;
    }
};

// Force and place go from (force, a.place) to (force + step, b.place).
moments segment(const node& a, const node& b, double force, double step)
{
    const integrals part(a, b);
    const double scale = step * (a.scale + b.scale), rise = b.place - a.place;
    const double zeroth = scale * part.zeroth, first = scale * part.first,
                 second = scale * part.second;
    moments sums;
    sums.mass = zeroth;
    sums.force = zeroth * force + first * step;
    sums.force_2 =
        zeroth * force * force + 2 * first * force * step + second * step * step;
    sums.place = zeroth * a.place + first * rise;
    sums.place_2 = zeroth * (a.place * a.place + 0.5 * (a.width + b.width)) +
                   2 * first * a.place * rise + second * rise * rise;
    sums.product = zeroth * force * a.place + first * (force * rise + step * a.place) +
                   second * step * rise;
    return sums;
}

// Least z^2 on a segment.
double least_square(double a, double b)
{
    return a * b <= 0 ? 0.0 : std::min(a * a, b * b);
}

} // namespace

likelihood_profile::likelihood_profile(std::vector<double> force,
                                       std::vector<double> rows,
                                       std::vector<std::uint8_t> holds)
    : d_force(std::move(force)), d_rows(std::move(rows)), d_holds(std::move(holds))
{
    const std::string where = "likelihood_profile";
    require(d_force.size() >= 2,
            where,
            "force",
            "must have at least 2 nodes",
            d_force.size());
    const auto size = d_force.size() * columns;
    require(d_rows.size() % size == 0,
            where,
            "rows",
            "must have columns x nodes numbers each",
            d_rows.size());
    require(d_holds.size() == this->rows() * (d_force.size() - 1),
            where,
            "holds",
            "must have a value for each segment of each row",
            d_holds.size());
}

std::size_t likelihood_profile::rows() const
{
    return d_rows.size() / (columns * d_force.size());
}

likelihood_profile::reading likelihood_profile::read(std::size_t row,
                                                     double offset_1,
                                                     double offset_2,
                                                     double noise_1,
                                                     double noise_2) const
{
    const auto count = d_force.size();
    const double* const values = &d_rows[row * columns * count];
    const auto at = [&](column c, std::size_t k) { return values[c * count + k]; };
    std::vector<node> nodes(count);
    for (std::size_t k = 0; k < count; k++) {
        const double e1 = at(error_1, k) + offset_1, e2 = at(error_2, k) + offset_2;
        const double s1 = at(slope_1, k), s2 = at(slope_2, k);
        const double v1 = at(variance_1, k) + noise_1, v2 = at(variance_2, k) + noise_2;
        const double total = s1 * s1 * v2 + s2 * s2 * v1 + least_variance;
        const double scale = 1 / std::sqrt(total);
        nodes[k].z = (s2 * e1 - s1 * e2) * scale;
        nodes[k].place = at(place, k) + (s1 * v2 * e1 + s2 * v1 * e2) * scale * scale;
        nodes[k].width = v1 * v2 * scale * scale;
        nodes[k].scale = scale;
    }

    const std::uint8_t* const holds = &d_holds[row * (count - 1)];
    std::vector<double> misfit(count - 1, std::numeric_limits<double>::infinity());
    for (std::size_t k = 0; k + 1 < count; k++)
        if (holds[k])
            misfit[k] = least_square(nodes[k].z, nodes[k + 1].z);
    const double best = *std::min_element(misfit.begin(), misfit.end());
    if (!std::isfinite(best))
        return { NAN, NAN, NAN, NAN, NAN, best, 0, 0, 0 };

    // Runs of likely segments are solutions; what lies between belongs to the run before.
    const double spread = std::sqrt(std::max({ noise_1, noise_2, 1.0 }));
    moments all, run, chosen;
    double chosen_mass = -1;
    int runs = 0;
    const auto close_run = [&] {
        // the calibrated span decides between solutions that fit alike
        const double inside_mass = run.mass - run.outside;
        const double worth =
            inside_mass > 1e-3 * run.mass ? inside_mass : 1e-9 * run.mass;
        if (worth > chosen_mass) {
            chosen = run;
            chosen_mass = worth;
        }
    };
    bool likely_before = false;
    std::size_t evaluated = 0; // nodes from here on are not
    for (std::size_t k = 0; k + 1 < count; k++) {
        const bool likely = misfit[k] < best + barrier;
        if (likely && !likely_before && runs++) {
            close_run();
            run = {};
        }
        likely_before = likely;
        if (!(misfit[k] < best + negligible))
            continue;
        for (evaluated = std::max(evaluated, k); evaluated < k + 2; evaluated++)
            nodes[evaluated].evaluate();
        auto sums =
            segment(nodes[k], nodes[k + 1], d_force[k], d_force[k + 1] - d_force[k]);
        sums.hidden = at(free, k) * spread > hidden_n ? sums.mass : 0.0;
        sums.outside = at(inside, k) > 0 && at(inside, k + 1) > 0 ? 0.0 : sums.mass;
        run += sums;
        all += sums;
    }
    close_run();

    const double mass = std::max(all.mass, std::numeric_limits<double>::min());
    const double chosen_by = std::max(chosen.mass, std::numeric_limits<double>::min());
    const auto& mean = runs > 1 ? chosen : all;
    const double mean_by = runs > 1 ? chosen_by : mass;
    const double f = mean.force / mean_by, l = mean.place / mean_by;
    // about the chosen solution, so that the standard deviation reaches the others
    return {
        f,
        l,
        std::max(all.force_2 / mass - 2 * f * all.force / mass + f * f, least_variance),
        std::max(all.place_2 / mass - 2 * l * all.place / mass + l * l, least_variance),
        all.product / mass - f * all.place / mass - l * all.force / mass + f * l,
        best,
        all.hidden / mass,
        all.outside / mass,
        runs > 1 ? 1.0 : 0.0
    };
}

} // namespace gr::wiforce::kernel
