// SPDX-License-Identifier: GPL-3.0-or-later
#include "press_reading.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace gr::wiforce::kernel {

namespace {

using complex = std::complex<double>;

constexpr double nan = std::numeric_limits<double>::quiet_NaN();
constexpr double degrees = 180 / M_PI;
// Phase std above which a disturbance of the tag's own lines is flagged: most of it may
// be hidden.
constexpr double disturbed_deg = 1.0;
// Standard deviations beyond which a reading is wrong. That of a mixture is no such
// limit: an explanation of weight w may lie 1 / sqrt(w) away, so that each is held within
// with so many of its own deviations (docs/press.md, Readings).
constexpr double far = 5.0, likely = 1.5;
// Of an off state, for the derivative of a phase by it.
constexpr double off_step = 1e-4;

double wrapped_deg(complex value)
{
    const double angle = degrees * std::arg(value);
    return angle <= -180 ? angle + 360 : angle;
}

// The reflection |G| = 1 in the direction of `start` R from the off state.
complex on_circle(complex ratio, complex start, complex off)
{
    const complex towards = ratio * start / std::abs(ratio * start);
    const double along = (towards * std::conj(off)).real();
    return off + towards * (std::sqrt(along * along + 1 - std::norm(off)) - along);
}

} // namespace

press_reading::press_reading(const press_posterior& posterior,
                             const sensor& of,
                             const bits& flags,
                             const limits& at)
    : d_posterior(posterior), d_sensor(of), d_bits(flags), d_limits(at)
{
}

// R against the untouched line, psi of both ends, and standard deviations of the error of
// each and of that which both share, with its sign (docs/theory.md, The off state); in a
// group that is rotated by as much as `rotation_variance`.
press_reading::phases press_reading::phases_of(const press_outcome& of,
                                               double rotation_variance) const
{
    phases found;
    const double common = of.common_variance + rotation_variance,
                 apart = of.difference_variance / 4, both = common - apart,
                 lines[2] = { common + apart + of.covariance,
                              common + apart - of.covariance };
    // Of the line's errors at both ends; one that is the larger where it is noisier.
    const double shared =
        std::abs(both) > 0
            ? std::min(std::abs(both) / std::sqrt(lines[0] * lines[1]), 1.0)
            : 0;
    for (int end = 0; end < 2; end++) {
        const complex off = d_sensor.off[end],
                      start = std::polar(1.0, d_sensor.untouched_rad[end]);
        const complex level = std::exp(complex(of.mean.amplitude[end] - of.amplitude[end],
                                               of.mean.phase[end] - of.baseline[end]));
        const complex circle = on_circle(level, start - off, off);
        const complex switched =
            d_sensor.off_states_differ ? circle - off : level * (start - off);
        const complex reflection = off + switched;
        const double slope =
            d_sensor.off_states_differ
                ? std::norm(switched) / (switched * std::conj(reflection)).real()
                : std::abs(switched) / std::abs(reflection);
        double variance = of.mean.variance[end] + (1 - shared) * lines[end];
        if (d_sensor.tag_ratio) {
            // A ratio of antennas (S_1 + T_1) / (S_2 + T_2) is not linear in the tag: an
            // error of Im[(1 - R) T_2 / S_2], at a phase that is unknown.
            const double bend =
                d_sensor.tag_ratio * std::abs(1.0 - std::polar(1.0, of.mean.phase[end]));
            variance += bend * bend / 2;
        }
        double std = degrees * std::sqrt(variance) * slope;
        if (d_sensor.off_std) {
            double error = 0;
            for (const complex step : { complex(off_step, 0), complex(0, off_step) }) {
                const complex beside = on_circle(level, start - off - step, off + step);
                error = std::hypot(
                    error, degrees * std::arg(beside * std::conj(circle)) / off_step);
            }
            std = std::hypot(std, d_sensor.off_std * error);
        }
        found.level[end] = level;
        found.deg[end] = wrapped_deg(reflection);
        found.own_deg[end] = std;
        found.shared_deg[end] =
            degrees * std::sqrt(shared * lines[end]) * slope * (end && both < 0 ? -1 : 1);
    }
    return found;
}

press_reading::reading press_reading::read(const sensor_group& of,
                                           const press_outcome* first,
                                           const press_outcome* end,
                                           bool wanted,
                                           press_posterior::workspace& work) const
{
    reading found{ -1,           nan, nan,      nan,      nan,
                   { nan, nan }, nan, of.flags, of.group, of.interference,
                   { nan, nan }, {},  false,    false,    false };
    if (!of.readable || first == end) {
        // What the stages before say explains that nothing is read.
        if (!of.overlapping && !(found.flags & ~(d_bits.inconsistent | d_bits.ambiguous)))
            found.flags |= d_bits.weak;
        found.clear = !found.flags;
        return found;
    }
    double by_state[press_states] = {}, doubtful = 0, turning = 0, in_part = 0;
    for (const auto* each = first; each != end; each++) {
        by_state[each->is] += each->weight;
        if (each->is != mixed && !each->known)
            doubtful += each->weight;
        turning += each->weight * each->turns;
        in_part += each->weight * each->in_part;
    }
    const double either =
        std::min(by_state[untouched], 1 - by_state[untouched] - by_state[mixed]);
    found.touch = by_state[untouched] <= 0.5;
    found.snr_db = of.snr_db;
    const bool changes = by_state[mixed] + in_part > d_limits.doubt;
    if (changes)
        found.flags |= d_bits.transition;
    if (by_state[unexplained] > d_limits.doubt)
        found.flags |= d_bits.inconsistent;
    found.doubtful = std::max(either, doubtful) > d_limits.doubt;
    if (found.doubtful)
        found.flags |= d_bits.ambiguous;
    if (turning > 0.5)
        found.flags |= d_bits.moved;
    const auto best = phases_of(*first, of.common_variance);
    found.level = best.level;
    found.phases_deg = best.deg;
    for (int end = 0; end < 2; end++)
        found.psi_std_deg[end] = std::hypot(best.own_deg[end], best.shared_deg[end]);
    const double larger = std::max(found.psi_std_deg[0], found.psi_std_deg[1]);
    // A change of this tag leaves a residual of its own.
    if (of.disturbed && larger > disturbed_deg && !changes)
        found.flags |= d_bits.inconsistent;
    if (larger > d_limits.weak_phase_deg)
        found.flags |= d_bits.weak;
    found.clear = !found.flags;
    // The deviation of what no press explains is wide.
    found.unexplained = by_state[unexplained] > 0.5 && !of.disturbed && !of.flags &&
                        !(found.flags & ~(d_bits.inconsistent | d_bits.weak));
    if (wanted && found.touch == 1) {
        invert(best, of.common_variance, first, end, found, work);
        if (!(found.force_std_n <= d_limits.weak_force_n))
            found.flags |= d_bits.weak;
    }
    return found;
}

void press_reading::invert(const phases& likeliest,
                           double rotation_variance,
                           const press_outcome* first,
                           const press_outcome* end,
                           reading& to,
                           press_posterior::workspace& work) const
{
    struct solution {
        double weight, mean[2], variance[2];
        double own(int column) const
        {
            return std::isnan(variance[column]) ? 0 : variance[column];
        }
    };
    std::vector<solution> solutions;
    solutions.reserve(end - first);
    double total = 0;
    for (const auto* next = first; next != end; next++) {
        const auto& each = *next;
        if (next != first && !(each.is == pressed && each.known))
            continue;
        const auto phases =
            next == first ? likeliest : phases_of(each, rotation_variance);
        press_fit::press press;
        const auto code = d_posterior.invert({ phases.deg.data(),
                                               phases.own_deg.data(),
                                               nullptr,
                                               phases.shared_deg.data() },
                                             work,
                                             press);
        // Flags are those of the likeliest explanation. Phases that changed inside the
        // group are those of no press.
        if (next == first && each.is != mixed)
            to.flags |= (code & ambiguous ? d_bits.ambiguous : 0) |
                        (code & force_unobservable ? d_bits.force_unobservable : 0) |
                        (code & inconsistent ? d_bits.inconsistent : 0) |
                        (code & extrapolated ? d_bits.extrapolated : 0);
        if (!std::isfinite(press.force) || !std::isfinite(press.location))
            continue;
        total += each.weight;
        solutions.push_back(
            { each.weight,
              { press.force, press.location },
              { press.force_variance, press.location_variance + d_sensor.ruler_mm2 } });
    }
    double means[2], stds[2];
    for (int column = 0; column < 2; column++) {
        double mean = 0, second = 0, farthest = 0;
        for (const auto& each : solutions)
            mean += each.weight * each.mean[column];
        mean /= total;
        for (const auto& each : solutions) {
            const double away = each.mean[column] - mean, own = each.own(column);
            second += each.weight * (own + away * away);
            farthest = std::max(farthest, std::abs(away) + likely * std::sqrt(own));
        }
        means[column] = mean;
        stds[column] = std::max(std::sqrt(second / total), farthest / far);
    }
    to.force_n = means[0];
    to.force_std_n = stds[0];
    to.location_mm = means[1];
    to.location_std_mm = stds[1];
}

} // namespace gr::wiforce::kernel
