// SPDX-License-Identifier: GPL-3.0-or-later
#include "location_scan.h"

#include "../clones.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace gr::wiforce::kernel {

namespace {

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
    std::fill(misfit, misfit + count, 0.0F);
    for (std::size_t p = 0; p < d_phases; p++) {
        const auto* const phase = &d_phase[(force * d_phases + p) * count];
        const auto* const slack = &d_slack[(force * d_phases + p) * count];
        const std::uint32_t psi = wanted.phase[p];
        const float noise = wanted.variance[p];
        for (std::size_t j = 0; j < count; j++) {
            const float error =
                static_cast<float>(static_cast<std::int32_t>(psi - phase[j])) *
                static_cast<float>(deg_per_count);
            misfit[j] += error * error / (noise + slack[j]);
        }
    }
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

std::size_t
location_scan::find(std::size_t force, const target& wanted, double* found_mm) const
{
    struct minimum {
        std::size_t node;
        float misfit;
    };
    constexpr std::size_t on_stack = 256;
    std::array<float, on_stack> few;
    std::vector<float> many;
    const auto count = d_location.size();
    float* misfit = few.data();
    if (count > on_stack) {
        many.resize(count);
        misfit = many.data();
    }
    misfits(force, wanted, misfit);
    const auto best =
        static_cast<std::size_t>(std::min_element(misfit, misfit + count) - misfit);
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

} // namespace gr::wiforce::kernel
