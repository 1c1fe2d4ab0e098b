// SPDX-License-Identifier: GPL-3.0-or-later
#include "end_separation.h"

#include "../clones.h"
#include "matrix_product.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

namespace gr::wiforce::kernel {

namespace {

constexpr double turn = 6.283185307179586476925;
constexpr double infinite = std::numeric_limits<double>::infinity();
constexpr double unknown = std::numeric_limits<double>::quiet_NaN();
// Noise gain of an end, relative to a perfect one, above which it counts as not separable
// (20 dB).
constexpr double worst_gain = 100.0;
// Ratio of a group's residual to the noise above which it raises the stated uncertainty.
// The ratio of noise alone has a standard deviation of 3.4 % (14 x 62 degrees of
// freedom): 4.4 of them.
constexpr double significant_residual = 1.15;
// Standard deviations above which a group's own coherent ratio, or the median, is more
// than noise. With 22 degrees of freedom, five are exceeded by 1 group in 10 000.
constexpr double group_stds = 5.0, lasting_stds = 4.0;
// Groups of the median. Bursts and presses that change disturb fewer than half of them.
constexpr std::size_t median_groups = 48;
// Factor above which what is received is not this tag and noise: a second tag on nearly
// the same clock hides most of itself in the ends. Rooms whose disturbances lie
// beside the lines reach 36, such tags 47 and more (SNR 10 dB, tests/rooms).
constexpr double is_disturbed = 42.0;
// The sandwich estimate has about a third of the degrees of freedom.
constexpr double freedom_share = 3.0;

// Subtracts all ends from parts, M x K. `switched`: M x 2E, of which the first E are what
// the waveforms leave in these.
WIFORCE_CLONES
void subtract_ends(const std::vector<double>& switched,
                   const end_fit& fit,
                   complex* parts)
{
    const auto& of = fit.sizes;
    add_product({ switched.data(), of.tones, of.ends, 2 * of.ends, 1, -1 },
                fit.ends.data(),
                of.subcarriers,
                parts);
}

// Adds two ends, from `first` on, to a tone.
WIFORCE_CLONES
void add_own(const std::vector<double>& switched,
             const end_fit& fit,
             std::size_t first,
             std::size_t row,
             complex* tone)
{
    const auto [pair, sign] = pair_of(row, fit.sizes.tones);
    for (std::size_t end = first; end < first + 2; end++) {
        const double* const response = &switched[4 * pair * fit.sizes.ends + end];
        add_scaled({ response[0], sign * response[2 * fit.sizes.ends] },
                   &fit.ends[end * fit.sizes.subcarriers],
                   fit.sizes.subcarriers,
                   tone);
    }
}

double energy_of(const complex* channel, const double* weights, std::size_t subcarriers)
{
    double sum = 0;
    for (std::size_t k = 0; k < subcarriers; k++)
        sum += std::norm(channel[k]) * weights[k];
    return sum;
}

WIFORCE_CLONES
double mean_power(const std::vector<complex>& values)
{
    return power_of(values.data(), values.size()) / double(values.size());
}

// Ratios of a group's residual along an end's channel to noise.
//
// The average over K subcarriers reduces independent noise by K. Leakage of movers,
// another tag, or an error of the clock is coherent over all of them, and is not reduced
// at all. What counts for the phase of an end is the residual's component along that
// end's channel, c_m = sum_k E_mk conj(V_k) / sigma_k^2: noise alone leaves sum_k |V_k|^2
// / sigma_k^2 of it on every tone.
//
// The sandwich estimator HC2 of J. MacKinnon and H. White (1985) takes the own power of
// each pair of opposite tones, whose shares are the same; `mean` is that of all tones.
struct coherence {
    double sandwich, mean;
};

WIFORCE_CLONES
std::vector<coherence> coherence_of(const end_fit& fit,
                                    const std::vector<double>& inverse_noise)
{
    const std::size_t count = fit.sizes.tones, columns = fit.sizes.ends,
                      subcarriers = fit.sizes.subcarriers;
    // Complex products in real ones: along = residual x matched, whose rows are of
    // the real and of the imaginary parts.
    std::vector<double> matched(subcarriers * columns * 4), along(count * columns * 2);
    std::vector<double> energy(columns, 1e-300), leverage(count);
    for (std::size_t k = 0; k < subcarriers; k++) {
        double* const by_real = &matched[4 * k * columns];
        double* const by_imag = by_real + 2 * columns;
        for (std::size_t end = 0; end < columns; end++) {
            const complex value = fit.ends[end * subcarriers + k];
            const double real = inverse_noise[k] * value.real(),
                         imag = inverse_noise[k] * value.imag();
            by_real[2 * end] = by_imag[2 * end + 1] = real;
            by_real[2 * end + 1] = -imag;
            by_imag[2 * end] = imag;
            energy[end] += real * value.real() + imag * value.imag();
        }
    }
    const auto* const residual = reinterpret_cast<const double*>(fit.residual.data());
    add_product(
        { residual, count, 2 * subcarriers }, matched.data(), 2 * columns, along.data());
    for (std::size_t tone = 0; tone < count; tone++)
        for (std::size_t end = 0; end < columns; end++)
            leverage[tone] +=
                fit.mixing[tone * columns + end] * fit.solver[end * count + tone];
    std::vector<coherence> found;
    for (std::size_t end = 0; end < columns; end++) {
        const double* const own = &fit.solver[end * count];
        double errors = 0, shares = 0, sum = 0;
        for (std::size_t tone = 0; tone + 1 < count; tone += 2) {
            const auto power_at = [&](std::size_t row) {
                const double* const value = &along[2 * (row * columns + end)];
                return (value[0] * value[0] + value[1] * value[1]) / energy[end];
            };
            const double power = power_at(tone) + power_at(tone + 1);
            const double share = own[tone] * own[tone] + own[tone + 1] * own[tone + 1];
            const double left = 1 - (leverage[tone] + leverage[tone + 1]) / 2;
            errors += share / 2 * power / std::max(left, 0.1);
            shares += share;
            sum += power;
        }
        found.push_back({ errors / shares, sum / fit.freedom() });
    }
    return found;
}

// Factor, at least 1, by which the variance of an end exceeds that of independent noise,
// and whether something is received on its lines that is no noise: by the sandwich
// estimate in the median of the last groups. A sudden rise in a single group is noticed
// by the mean of all tones, which fewer groups determine.
std::pair<double, bool>
excess(running_median& median, const coherence& of, double freedom)
{
    const double spread = 1 / std::sqrt(freedom);
    double factor = of.mean > 1 + group_stds * spread ? of.mean : 1;
    auto [lasting, count] = median.update(of.sandwich);
    // The median of a gamma distribution lies below its mean.
    lasting /= 1 - freedom_share / (3 * freedom);
    if (lasting > 1 + lasting_stds * spread * std::sqrt(freedom_share / count))
        factor = std::max(factor, lasting);
    // The mean of all tones underestimates what the change of another tag leaves near the
    // lines of this one.
    double near = lasting;
    if (of.mean > (1 + group_stds * spread) * std::max(lasting, 1.0)) {
        near = std::max(near, of.sandwich);
        factor = std::max(factor, near);
    }
    return { factor, near > is_disturbed };
}

} // namespace

std::pair<double, std::size_t> running_median::update(double value)
{
    d_latest.push_back(value);
    if (std::isfinite(value))
        d_sorted.insert(std::upper_bound(d_sorted.begin(), d_sorted.end(), value), value);
    if (d_latest.size() > median_groups) {
        const double oldest = d_latest.front();
        d_latest.pop_front();
        if (std::isfinite(oldest))
            d_sorted.erase(std::lower_bound(d_sorted.begin(), d_sorted.end(), oldest));
    }
    const std::size_t count = d_sorted.size();
    if (!count)
        return { infinite, 0 };
    return { (d_sorted[(count - 1) / 2] + d_sorted[count / 2]) / 2, count };
}

struct end_separation::one {
    std::size_t number, subcarriers;
    const group& of;
    const std::vector<tag>& tags;
    noise_estimate& noise;
    spread_lines* const spread;
    const remove_wander& wander;
    separated& found;
    std::vector<complex>& parts; // M x K; from the first fit on without spread lines
    std::vector<complex>& white; // those, whitened, by the first fit
    std::vector<double> phase{}, rate{}; // of the tags' clocks
    std::vector<char> received{};        // whether this group shows them
    std::vector<double> switched{};      // M x 4S, what the waveforms leave in the parts
    bool fitted = false;

    void receive()
    {
        const std::size_t rows = of.weights->tones();
        received.resize(tags.size());
        parts.resize(rows * subcarriers);
        std::visit(
            [&](const auto* tones) { parts_of(tones, rows, subcarriers, parts.data()); },
            of.tones);
        for (const auto& each : tags) {
            phase.push_back(each.clock->predict(of.center_s));
            rate.push_back(each.clock->rate);
        }
    }

    // At the present clocks; to tones without what tags spread over the subcarriers,
    // which hardly depends on how the clocks are corrected.
    end_fit fit(double averaging_s)
    {
        std::vector<switching_clock> clocks;
        std::vector<switching_pulses> pulses;
        for (std::size_t i = 0; i < tags.size(); i++) {
            const double total = tags[i].nominal_rate + rate[i];
            clocks.push_back({ phase[i], total, total * averaging_s / 2 });
            pulses.push_back(tags[i].pulses);
        }
        const std::size_t rows = of.weights->tones(), ends = 2 * tags.size();
        const double* const whitener = of.weights->whitener().data();
        switched = of.weights->switched(clocks.data(), pulses.data(), tags.size());
        std::vector<double> mixed(switched.size());
        whiten(whitener, switched.data(), rows, 2 * ends, mixed.data());
        end_fit found({ 1, rows, ends, subcarriers }, mixed.data());
        if (!std::exchange(fitted, true)) {
            if (spread && ends)
                spread->remove(found,
                               0,
                               *of.weights,
                               clocks.data(),
                               pulses.data(),
                               switched.data(),
                               parts.data());
            white.resize(parts.size());
            whiten(whitener, parts.data(), rows, subcarriers, white.data());
        }
        found.solve(white.data());
        return found;
    }
};

end_separation::separated end_separation::process(const std::vector<tag>& tags,
                                                  const std::vector<group>& groups,
                                                  std::size_t subcarriers,
                                                  noise_estimate& noise,
                                                  bool update,
                                                  spread_lines* spread,
                                                  const remove_wander& wander)
{
    separated found;
    std::vector<complex> parts, white;
    for (const auto& group : groups) {
        const auto given_up = [&](const tag& each) {
            return each.clock->expired(
                group.center_s, d_settings.absent_s, d_settings.unseen_s);
        };
        if (found.outcome != noise_estimate::verdict::learned ||
            (update && found.groups && std::any_of(tags.begin(), tags.end(), given_up)))
            break;
        one next{ found.groups, subcarriers, group, tags,  noise,
                  spread,       wander,      found, parts, white };
        next.receive();
        find_tags(next, update);
        separate(next, update);
        found.groups++;
    }
    return found;
}

// Whether the group holds each tag: a tag that was acquired in other groups may be silent
// in this one.
void end_separation::find_tags(one& group, bool correct) const
{
    const auto& tags = group.tags;
    const std::size_t subcarriers = group.subcarriers;
    const auto& weights = *group.of.weights;
    const double* const inverse_noise = group.noise.inverse().data();
    std::vector<clock_tracker::measurement> errors;
    std::vector<complex> own;
    std::optional<end_fit> fit;
    auto& parts = group.parts; // only what is whitened is fitted once they are changed
    if (tags.size() > 1 || d_settings.jointly || group.spread) {
        fit.emplace(group.fit(d_settings.averaging_s));
        if (d_settings.jointly)
            errors = phase_errors(information_of(*fit, inverse_noise));
    }
    if (tags.size() > 1)
        subtract_ends(group.switched, *fit, parts.data());
    const double noise_level = group.noise.level();
    for (std::size_t i = 0; i < tags.size(); i++) {
        const auto& lines = tags[i].lines;
        own.resize(lines.size() * subcarriers);
        for (std::size_t line = 0; line < lines.size(); line++) {
            complex* const tone = &own[line * subcarriers];
            tone_of(parts.data(), lines[line], weights.tones(), subcarriers, tone);
            if (tags.size() > 1)
                add_own(group.switched, *fit, 2 * i, lines[line], tone);
        }
        auto& clock = *tags[i].clock;
        auto likelihood = tags[i].likelihood->at(
            group.phase[i], own.data(), inverse_noise, subcarriers);
        for (double& each : likelihood)
            each /= weights.loss;
        if (!correct) {
            group.received[i] = clock.shown_by(likelihood, noise_level);
            continue;
        }
        group.received[i] = clock.update(group.of.center_s,
                                         likelihood,
                                         noise_level,
                                         errors.empty() ? nullptr : &errors[i]);
        group.phase[i] = clock.phase;
        group.rate[i] = clock.rate;
    }
}

void end_separation::separate(one& group, bool update)
{
    const std::size_t subcarriers = group.subcarriers;
    auto& found = group.found;
    auto fit = group.fit(d_settings.averaging_s);
    if (group.wander)
        group.wander(group.number, fit, group.phase, group.rate);
    auto residual = fit.power();
    for (double& each : residual)
        each /= fit.freedom();
    const auto noise = group.noise.follow(std::move(residual),
                                          fit.freedom(),
                                          mean_power(group.white),
                                          update && group.of.complete);
    found.outcome = noise.outcome;
    const auto ratios = coherence_of(fit, noise.inverse);

    const double level = group.noise.level();
    const std::size_t end0 = 2 * d_settings.tags * group.number,
                      tag0 = d_settings.tags * group.number;
    const std::size_t tags = tag0 + d_settings.tags;
    found.ends.resize(2 * tags * subcarriers);
    found.gain.resize(2 * tags, infinite);
    found.snr_db.resize(2 * tags, unknown);
    for (auto* values : { &found.locked, &found.overlapping, &found.disturbed })
        values->resize(tags);
    for (auto* values :
         { &found.clock_phase, &found.clock_offset_ppm, &found.clock2_delay })
        values->resize(tags);
    double kept = 0;
    for (std::size_t k = 0; k < subcarriers; k++) {
        found.noise.push_back(group.noise.variance()[k] * noise.raised[k]);
        found.noise_rise.push_back(noise.raised[k]);
        kept += 1 / noise.raised[k];
    }
    found.raised.push_back(1 - kept / subcarriers);
    const double ratio = noise.ratio > significant_residual ? noise.ratio : 1.0;
    for (std::size_t i = 0; i < group.tags.size(); i++) {
        const auto& tag = group.tags[i];
        const std::size_t place = tag0 + tag.index;
        for (std::size_t end = 2 * i; end < 2 * i + 2; end++) {
            const std::size_t row = 2 * tag.index + end % 2;
            const auto [factor, disturbed] =
                excess(d_coherent[row], ratios[end], fit.freedom());
            found.disturbed[place] |= disturbed;
            const complex* const channel = &fit.ends[end * subcarriers];
            std::copy_n(channel, subcarriers, &found.ends[(end0 + row) * subcarriers]);
            // In units of the whole group: a perfect end would have 1/N.
            const double gain = fit.gain[end];
            if (!(gain * d_settings.group_length < worst_gain))
                continue;
            found.gain[end0 + row] = gain * std::max(factor, ratio);
            if (d_settings.least_error > 0)
                found.gain[end0 + row] +=
                    2 * std::pow(d_settings.least_error, 2) *
                    energy_of(channel, noise.inverse.data(), subcarriers);
            const double power =
                power_of(channel, subcarriers) / subcarriers - gain * level;
            found.snr_db[end0 + row] =
                10 * std::log10(std::max(d_settings.line_power * power / level, 1e-12));
        }
        if (!group.received[i])
            continue;
        found.locked[place] = true;
        found.overlapping[place] = tag.overlapping;
        const double phase = std::fmod(group.phase[i], turn);
        found.clock_phase[place] = phase < 0 ? phase + turn : phase;
        found.clock_offset_ppm[place] =
            1e6 * (tag.nominal_rate - tag.stated_rate + group.rate[i]) / tag.stated_rate;
        found.clock2_delay[place] = tag.pulses.delay;
    }
}

} // namespace gr::wiforce::kernel
