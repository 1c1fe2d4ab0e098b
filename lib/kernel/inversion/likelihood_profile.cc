// SPDX-License-Identifier: GPL-3.0-or-later
#include "likelihood_profile.h"

#include "../clones.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <tuple>

namespace gr::wiforce::kernel {

namespace {

// Forces at which the branches of the profile are sought.
constexpr std::size_t rough_forces = 25;
// Between two of them the profile is halved until the residual in the middle is that of a
// straight line to this, in standard deviations; but not more often than so.
constexpr double straight = 0.05;
constexpr int most_halvings = 9;
constexpr std::size_t most_points = 400;
// What is this much less likely than the best (squared standard deviations) does not
// count.
constexpr double negligible = 40.0;
// The location is fitted to this; the residual's error grows with its square (0.15
// deg/mm^2 where the far end's movement fades over 5 mm, at 900 MHz).
constexpr double rough_mm = 0.5, fine_mm = 0.05;
constexpr double least_noise = 1e-9; // deg^2

// Largest change of a phase from one location of the grid to the next.
constexpr double largest_step_deg = 20.0;
constexpr double deg_per_count = 360.0 / 4294967296.0;

// Nodes of the table from one location of the grid to the next.
std::size_t stride_of(const tabulated_model& model)
{
    double largest = 0;
    for (std::size_t i = 0; i < model.force_n().size(); i++)
        for (std::size_t j = 1; j < model.location_mm().size(); j++)
            for (std::size_t p = 0; p < model.phases(); p++)
                largest = std::max(
                    largest,
                    std::abs(model.at_node(i, j, p) - model.at_node(i, j - 1, p)));
    const auto most = static_cast<double>(model.location_mm().size() - 1);
    return static_cast<std::size_t>(
        std::clamp(largest_step_deg / std::max(largest, 1e-9), 1.0, most));
}

std::vector<std::size_t> spread(std::size_t nodes)
{
    const auto count = std::min(rough_forces, nodes);
    std::vector<std::size_t> chosen(count);
    for (std::size_t i = 0; i < count; i++)
        chosen[i] = (i * (nodes - 1) + (count - 1) / 2) / (count - 1);
    return chosen;
}

likelihood_profile::segment
between(const press_fit::point& from, const press_fit::point& to, std::size_t phases)
{
    double square = 0, step = 0, along = 0;
    for (std::size_t p = 0; p < phases; p++) {
        const double change = to.residual[p] - from.residual[p];
        square += from.residual[p] * from.residual[p];
        step += change * change;
        along += from.residual[p] * change;
    }
    const double length = std::sqrt(step), z = length > 0 ? along / length : 0.0;
    const double rest = std::max(square - z * z, 0.0), end = z + length;
    const double nearest = z * end <= 0 ? 0.0 : std::min(z * z, end * end);
    return { 0, 0, z, end, rest, rest + nearest };
}

} // namespace

std::uint32_t location_scan::counts(double phase_deg)
{
    const double turns = phase_deg / 360;
    return static_cast<std::uint32_t>(
        static_cast<std::int64_t>((turns - std::floor(turns)) * 4294967296.0));
}

location_scan::location_scan(const tabulated_model& model,
                             const std::vector<std::size_t>& forces)
    : d_phases(model.phases())
{
    const auto& all = model.location_mm();
    const auto stride = stride_of(model);
    std::vector<std::size_t> nodes;
    for (std::size_t j = 0; j + 1 < all.size(); j += stride)
        nodes.push_back(j);
    nodes.push_back(all.size() - 1);
    for (const auto j : nodes)
        d_location.push_back(all[j]);
    d_reach_mm = static_cast<double>(stride) * (all[1] - all[0]);
    for (const auto force : forces)
        for (std::size_t p = 0; p < d_phases; p++)
            for (std::size_t n = 0; n < nodes.size(); n++) {
                const auto before = nodes[n ? n - 1 : 0],
                           after = nodes[std::min(n + 1, nodes.size() - 1)];
                const double half_step = 0.25 * (model.at_node(force, after, p) -
                                                 model.at_node(force, before, p));
                d_phase.push_back(counts(model.at_node(force, nodes[n], p)));
                d_slack.push_back(static_cast<float>(half_step * half_step));
            }
}

WIFORCE_CLONES
void location_scan::misfits(std::size_t force, const target& wanted, float* misfit) const
{
    const auto count = d_location.size();
    auto *const along = misfit + count, *const square = along + count;
    std::fill(misfit, misfit + 3 * count, 0.0F);
    for (std::size_t p = 0; p < d_phases; p++) {
        const auto* const phase = &d_phase[(force * d_phases + p) * count];
        const auto* const slack = &d_slack[(force * d_phases + p) * count];
        const std::uint32_t psi = wanted.phase[p];
        const float noise = wanted.variance[p], shared = wanted.shared[p];
        for (std::size_t j = 0; j < count; j++) {
            const float error =
                static_cast<float>(static_cast<std::int32_t>(psi - phase[j])) *
                static_cast<float>(deg_per_count);
            const float weight = 1 / (noise + slack[j]);
            misfit[j] += error * error * weight;
            along[j] += error * shared * weight;
            square[j] += shared * shared * weight;
        }
    }
    for (std::size_t j = 0; j < count; j++)
        misfit[j] -= along[j] * along[j] / (1 + square[j]);
}

bool location_scan::beyond_quarter_turn(std::size_t force,
                                        std::size_t node,
                                        const target& wanted) const
{
    constexpr std::int32_t quarter = 1 << 30;
    for (std::size_t p = 0; p < d_phases; p++) {
        const auto phase = d_phase[(force * d_phases + p) * d_location.size() + node];
        const auto error = static_cast<std::int32_t>(wanted.phase[p] - phase);
        if (error > quarter || error < -quarter)
            return true;
    }
    return false;
}

std::size_t location_scan::find(std::size_t force,
                                const target& wanted,
                                std::vector<float>& misfit,
                                double* found_mm) const
{
    struct minimum {
        std::size_t node;
        float misfit;
    };
    const auto count = d_location.size();
    misfit.resize(3 * count);
    misfits(force, wanted, misfit.data());
    const std::size_t best =
        std::min_element(misfit.begin(), misfit.begin() + count) - misfit.begin();
    std::array<minimum, most_found> kept;
    std::size_t found = 0;
    for (std::size_t j = 0; j < count; j++) {
        const bool lowest = (j == 0 || misfit[j] < misfit[j - 1]) &&
                            (j + 1 == count || misfit[j] <= misfit[j + 1]);
        if (!lowest || (j != best && beyond_quarter_turn(force, j, wanted)))
            continue;
        if (found == most_found) {
            const auto worst = std::max_element(
                kept.begin(), kept.end(), [](const auto& a, const auto& b) {
                    return a.misfit < b.misfit;
                });
            if (misfit[j] > worst->misfit)
                continue;
            std::copy(worst + 1, kept.end(), worst);
            found--;
        }
        kept[found++] = { j, misfit[j] };
    }
    for (std::size_t i = 0; i < found; i++)
        found_mm[i] = d_location[kept[i].node];
    return found;
}

// Branches of the profile at a few forces: a press half a wavelength further shows the
// same phases, and branches may fork.
struct likelihood_profile::branches {
    static constexpr std::size_t per_force = location_scan::most_found;
    static constexpr std::size_t most = rough_forces * per_force;
    static constexpr std::size_t none = most;

    // A branch is a run of steps, from one force to the next.
    struct step {
        std::size_t point, branch;
    };

    // Bounds of the least squared residual from a step to the next.
    struct bounds {
        double least, most;
    };

    std::size_t phases, forces;
    double most_apart; // locations of a branch at neighbouring forces, mm
    std::array<press_fit::point, most> points;
    std::array<std::size_t, rough_forces> count;
    std::array<std::size_t, most> next, previous; // of the same branch
    std::array<step, 3 * most> steps;             // every point with both its neighbours
    std::size_t length;

    // The point at a force that is nearest to a location.
    std::size_t nearest(std::size_t force, double location) const
    {
        std::size_t found = none;
        double least = most_apart;
        for (std::size_t m = 0; m < count[force]; m++) {
            const auto i = force * per_force + m;
            const double apart = std::abs(points[i].location - location);
            if (apart < least) {
                least = apart;
                found = i;
            }
        }
        return found;
    }

    // Joins points that are nearest to each other. Where a branch ends it forked from
    // another: the nearest point of that is its last.
    void trace()
    {
        next.fill(none);
        previous.fill(none);
        const auto neighbour = [&](std::size_t i, std::size_t force) {
            return nearest(force, points[i].location);
        };
        for (std::size_t k = 0; k + 1 < forces; k++)
            for (std::size_t m = 0; m < count[k]; m++) {
                const auto i = k * per_force + m, there = neighbour(i, k + 1);
                if (there != none && neighbour(there, k) == i) {
                    next[i] = there;
                    previous[there] = i;
                }
            }
        length = 0;
        std::size_t branch = 0;
        const auto append = [&](std::size_t i) {
            if (i != none)
                steps[length++] = { i, branch };
        };
        for (std::size_t k = 0; k < forces; k++)
            for (std::size_t m = 0; m < count[k]; m++) {
                auto i = k * per_force + m;
                if (previous[i] != none)
                    continue;
                if (k > 0)
                    append(neighbour(i, k - 1));
                auto last = k;
                for (append(i); next[i] != none; append(i), last++)
                    i = next[i];
                if (last + 1 < forces)
                    append(neighbour(i, last + 1));
                branch++;
            }
    }

    // Whether no branch has more than one force: locations jump from force to force.
    bool scattered() const
    {
        for (std::size_t s = 0; s < length; s++)
            if (joined(s))
                return false;
        return true;
    }

    bool joined(std::size_t s) const
    {
        return s + 1 < length && steps[s].branch == steps[s + 1].branch;
    }

    // The error of linear interpolation about a step, from second differences.
    double bend(std::size_t s) const
    {
        if (s == 0 || !joined(s - 1) || !joined(s))
            return 0;
        const auto &before = points[steps[s - 1].point], &here = points[steps[s].point],
                   &after = points[steps[s + 1].point];
        double square = 0;
        for (std::size_t p = 0; p < phases; p++) {
            const double second =
                before.residual[p] - 2 * here.residual[p] + after.residual[p];
            square += second * second;
        }
        return std::sqrt(square) / 8;
    }

    bounds misfit_after(std::size_t s) const
    {
        const double error = 1.5 * std::max(bend(s), bend(s + 1));
        const double line = std::sqrt(
            between(points[steps[s].point], points[steps[s + 1].point], phases).misfit);
        const double nearer = std::max(line - error, 0.0), farther = line + error;
        return { nearer * nearer, farther * farther };
    }
};

likelihood_profile::likelihood_profile(tabulated_model model, double consistent)
    : d_fit(std::move(model)),
      d_consistent(consistent),
      d_forces(spread(d_fit.model().force_n().size())),
      d_scan(d_fit.model(), d_forces)
{
}

double likelihood_profile::inflation(double misfit) const
{
    // location is free: one degree of freedom less
    const auto freedom = static_cast<double>(d_fit.model().phases() - 1);
    return misfit <= d_consistent ? 1.0 : misfit / freedom;
}

void likelihood_profile::draw_rough(const phase_reading& wanted, branches& out) const
{
    out.phases = d_fit.model().phases();
    out.forces = d_forces.size();
    out.most_apart = 4 * d_scan.reach_mm();
    location_scan::target target;
    std::vector<float> misfit;
    for (std::size_t p = 0; p < out.phases; p++) {
        target.phase[p] = location_scan::counts(wanted.phase[p]);
        target.variance[p] =
            static_cast<float>(std::max(wanted.std[p] * wanted.std[p], least_noise));
        target.shared[p] = wanted.shared ? static_cast<float>(wanted.shared[p]) : 0;
    }
    for (std::size_t k = 0; k < out.forces; k++) {
        double location[location_scan::most_found];
        if (wanted.location) {
            out.count[k] = 1;
            location[0] = *wanted.location;
        } else
            out.count[k] = d_scan.find(k, target, misfit, location);
        for (std::size_t m = 0; m < out.count[k]; m++) {
            auto& at = out.points[k * branches::per_force + m];
            at.steps = static_cast<double>(d_forces[k]);
            at.force = d_fit.model().force_n()[d_forces[k]];
            at.location = location[m];
            // from what was found at the force before, if that is as near
            const auto before = k ? out.nearest(k - 1, location[m]) : branches::none;
            if (before != branches::none &&
                std::abs(out.points[before].location - location[m]) < d_scan.reach_mm())
                at.location = out.points[before].location;
            d_fit.at_force(wanted, d_scan.reach_mm(), rough_mm, at);
        }
    }
    out.trace();
    if (out.scattered()) {
        out.most_apart = std::numeric_limits<double>::infinity();
        out.trace();
    }
}

void likelihood_profile::halve(const phase_reading& wanted,
                               const press_fit::point& from,
                               const press_fit::point& to,
                               std::size_t branch,
                               int halvings,
                               double reach,
                               curve& out) const
{
    const auto phases = d_fit.model().phases();
    press_fit::point middle;
    middle.steps = 0.5 * (from.steps + to.steps);
    middle.force = std::sqrt(from.force * to.force);
    middle.location = 0.5 * (from.location + to.location);
    d_fit.at_force(wanted, d_scan.reach_mm(), fine_mm, middle);
    double square = 0;
    for (std::size_t p = 0; p < phases; p++) {
        const double bend =
            middle.residual[p] - 0.5 * (from.residual[p] + to.residual[p]);
        square += bend * bend;
    }
    const double bend = std::sqrt(square);
    const auto half = [&](const auto& begin, const auto& end) {
        const auto line = between(begin, end, phases);
        const double nearest = std::max(std::sqrt(line.misfit) - bend, 0.0);
        if (halvings > 1 && bend > straight && nearest * nearest < reach &&
            out.points.size() < most_points) {
            halve(wanted, begin, end, branch, halvings - 1, reach, out);
            return;
        }
        out.segments.push_back(line);
        out.segments.back().point = out.points.size() - 1;
        out.segments.back().branch = branch;
        out.points.push_back(end);
    };
    half(from, middle);
    half(middle, to);
}

void likelihood_profile::draw(const phase_reading& wanted, curve& out) const
{
    branches rough;
    draw_rough(wanted, rough);
    std::array<double, std::tuple_size_v<decltype(rough.steps)>> least;
    double misfit = std::numeric_limits<double>::infinity();
    for (std::size_t s = 0; s < rough.length; s++) {
        if (!rough.joined(s))
            continue;
        const auto bounds = rough.misfit_after(s);
        least[s] = bounds.least;
        misfit = std::min(misfit, bounds.most);
    }
    const double reach = misfit + negligible * inflation(misfit);
    out.points.clear();
    out.segments.clear();
    const auto settled = [&](std::size_t s) {
        auto point = rough.points[rough.steps[s].point];
        d_fit.at_force(wanted, d_scan.reach_mm(), fine_mm, point);
        return point;
    };
    bool continued = false; // from the segment before
    for (std::size_t s = 0; s < rough.length; s++) {
        if (!rough.joined(s) || least[s] > reach) {
            continued = false;
            continue;
        }
        if (!continued)
            out.points.push_back(settled(s));
        const auto from = out.points.back();
        halve(wanted,
              from,
              settled(s + 1),
              rough.steps[s].branch,
              most_halvings,
              reach,
              out);
        continued = true;
    }
    misfit = std::numeric_limits<double>::infinity();
    for (const auto& segment : out.segments)
        misfit = std::min(misfit, segment.misfit);
    out.inflation = inflation(misfit);
}

} // namespace gr::wiforce::kernel
