// SPDX-License-Identifier: GPL-3.0-or-later
#include "end_separation.h"

#include "../algebra/complex_rows.h"
#include "../algebra/matrix_product.h"
#include "../clones.h"
#include "phase_expansion.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <numeric>

namespace gr::wiforce::kernel {

namespace {

using complex = std::complex<double>;

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

// Makes parts, or a mixing matrix of them, from whitened ones.
template <class T>
WIFORCE_CLONES void
color(const group_weights& weights, const T* white, std::size_t columns, T* parts)
{
    triangular_product(weights.colorer().data(), weights.tones(), white, columns, parts);
}

// Subtracts all ends from parts, M x K, that are not whitened. `mixing`: M x E, of these.
WIFORCE_CLONES
void subtract_ends(const std::vector<double>& mixing, const end_fit& fit, complex* parts)
{
    std::vector<double> packed;
    add_product({ mixing.data(), fit.sizes.ends, 1, -1 },
                fit.sizes.tones,
                fit.sizes.ends,
                fit.ends.data(),
                fit.sizes.subcarriers,
                parts,
                packed);
}

// Adds two ends, from `first` on, to a tone.
WIFORCE_CLONES
void add_own(const std::vector<double>& mixing,
             const end_fit& fit,
             std::size_t first,
             std::size_t row,
             complex* tone)
{
    const auto [pair, sign] = pair_of(row, fit.sizes.tones);
    for (std::size_t end = first; end < first + 2; end++) {
        const double* const response = &mixing[2 * pair * fit.sizes.ends + end];
        add_scaled({ response[0], sign * response[fit.sizes.ends] },
                   &fit.ends[end * fit.sizes.subcarriers],
                   fit.sizes.subcarriers,
                   tone);
    }
}

double energy_of(const complex* channel, const double* weights, std::size_t subcarriers)
{
    if (!weights)
        return power_of(channel, subcarriers);
    double sum = 0;
    for (std::size_t k = 0; k < subcarriers; k++)
        sum += std::norm(channel[k]) * weights[k];
    return sum;
}

} // namespace

struct end_separation::one {
    std::size_t number, subcarriers;
    const group& of;
    const std::vector<tag>& tags;
    noise_estimate& noise;
    const corrections& by;
    separated& found;
    std::vector<double> phase{}, rate{}; // of the tags' clocks
    std::vector<char> received{};
    std::vector<complex> parts{}, white{}; // M x K, as received and whitened
    double level = 0;                      // mean power of the whitened parts
    std::vector<complex> cleaned{};        // whitened parts without spread lines

    void receive()
    {
        const std::size_t rows = of.weights->tones(), count = rows * subcarriers;
        parts.resize(count);
        if (of.single)
            parts_of(of.single, rows, subcarriers, parts.data());
        else
            parts_of(of.tones, rows, subcarriers, parts.data());
        white.resize(count);
        level = whiten(
            of.weights->whitener().data(), parts.data(), rows, subcarriers, white.data());
    }

    // At the present clocks; to tones without what tags spread over the subcarriers.
    end_fit fit(const settings& with, bool with_slopes)
    {
        std::vector<switching_mixer::clock> clocks;
        std::vector<switching_mixer::pulses> pulses;
        for (std::size_t i = 0; i < tags.size(); i++) {
            const double total = tags[i].nominal_rate + rate[i];
            clocks.push_back({ phase[i], total, total * with.averaging_s / 2 });
            pulses.push_back(tags[i].pulses);
        }
        const auto mixed =
            of.weights->mixer.mix(clocks.data(), pulses.data(), tags.size(), with_slopes);
        end_fit found({ 1, of.weights->tones(), 2 * tags.size(), subcarriers },
                      mixed.data(),
                      white.data());
        if (by.spread && !tags.empty()) {
            cleaned = by.spread(number, found, phase, rate);
            found.solve(cleaned.data());
        }
        return found;
    }
};

end_separation::separated end_separation::process(const std::vector<tag>& tags,
                                                  const std::vector<group>& groups,
                                                  std::size_t subcarriers,
                                                  noise_estimate& noise,
                                                  bool update,
                                                  const corrections& by)
{
    separated found;
    for (std::size_t number = 0;
         number < groups.size() && found.outcome == noise_estimate::verdict::learned;
         number++) {
        const auto& group = groups[number];
        if (update && number &&
            std::any_of(tags.begin(), tags.end(), [&](const tag& each) {
                return d_settings.limits.expired(*each.clock, group.center_s);
            }))
            break;
        one next{ number, subcarriers, group, tags, noise, by, found };
        next.receive();
        for (const auto& each : tags) {
            next.phase.push_back(each.clock->predict(group.center_s));
            next.rate.push_back(each.clock->rate);
            next.received.push_back(each.clock->seen_s >= group.center_s - 1e-9);
        }
        if (update)
            correct_clocks(next);
        separate(next, update);
        found.groups++;
    }
    return found;
}

void end_separation::correct_clocks(one& group) const
{
    const auto& tags = group.tags;
    const std::size_t subcarriers = group.subcarriers;
    const auto& weights = *group.of.weights;
    const auto& inverse_noise = group.noise.inverse();
    std::vector<clock_tracker::measurement> errors;
    std::vector<double> mixing;
    std::vector<complex> own;
    std::unique_ptr<end_fit> fit;
    auto& parts = group.parts;
    if (tags.size() > 1 || d_settings.jointly || group.by.spread) {
        fit = std::make_unique<end_fit>(group.fit(d_settings, d_settings.jointly));
        if (d_settings.jointly)
            errors = phase_errors(phase_expansion(*fit).informed(inverse_noise.data()));
        if (!group.cleaned.empty())
            color(weights, group.cleaned.data(), subcarriers, parts.data());
    }
    if (tags.size() > 1) {
        mixing.resize(fit->mixing.size());
        color(weights, fit->mixing.data(), fit->sizes.ends, mixing.data());
        subtract_ends(mixing, *fit, parts.data());
    }
    const double noise_level = group.noise.level();
    for (std::size_t i = 0; i < tags.size(); i++) {
        const auto& lines = tags[i].lines;
        own.resize(lines.size() * subcarriers);
        for (std::size_t line = 0; line < lines.size(); line++) {
            complex* const tone = &own[line * subcarriers];
            tone_of(parts.data(), lines[line], weights.tones(), subcarriers, tone);
            if (tags.size() > 1)
                add_own(mixing, *fit, 2 * i, lines[line], tone);
        }
        auto likelihood = tags[i].likelihood->at(
            group.phase[i], own.data(), inverse_noise.data(), subcarriers);
        for (double& each : likelihood)
            each /= weights.loss;
        group.received[i] = tags[i].clock->update(group.of.center_s,
                                                  likelihood.data(),
                                                  noise_level,
                                                  errors.empty() ? nullptr : &errors[i]);
        group.phase[i] = tags[i].clock->phase;
        group.rate[i] = tags[i].clock->rate;
    }
}

void end_separation::separate(one& group, bool update)
{
    const std::size_t count = d_settings.tags, subcarriers = group.subcarriers;
    auto& found = group.found;
    auto fit = group.fit(d_settings, bool(group.by.wander));
    if (group.by.wander)
        group.by.wander(group.number, fit, group.phase, group.rate);
    auto residual = fit.power();
    for (double& each : residual)
        each /= fit.freedom();
    const auto noise = group.noise.follow(
        residual.data(), fit.freedom(), { group.level }, { update && group.of.complete });
    found.outcome = noise.outcome;
    std::vector<std::size_t> rows;
    for (const auto& tag : group.tags)
        rows.insert(rows.end(), { 2 * tag.index, 2 * tag.index + 1 });
    const auto coherence = d_coherence.update(fit, rows, noise.inverse.data());

    const double level =
        std::accumulate(noise.variance.begin(), noise.variance.end(), 0.0) / subcarriers;
    const std::size_t end0 = found.gain.size(), tag0 = found.locked.size();
    found.ends.resize(found.ends.size() + 2 * count * subcarriers);
    found.gain.resize(end0 + 2 * count, infinite);
    found.snr_db.resize(end0 + 2 * count, unknown);
    for (auto* values : { &found.locked, &found.overlapping, &found.disturbed })
        values->resize(tag0 + count);
    for (auto* values :
         { &found.clock_phase, &found.clock_offset_ppm, &found.clock2_delay })
        values->resize(tag0 + count);
    double kept = 0;
    for (std::size_t k = 0; k < subcarriers; k++) {
        found.noise.push_back(noise.variance[k] * noise.raised[k]);
        kept += 1 / noise.raised[k];
    }
    found.raised.push_back(1 - kept / subcarriers);
    found.noise_rise.insert(
        found.noise_rise.end(), noise.raised.begin(), noise.raised.end());
    const double ratio = noise.ratio[0] > significant_residual ? noise.ratio[0] : 1.0;
    for (std::size_t end = 0; end < rows.size(); end++) {
        const complex* const channel = &fit.ends[end * subcarriers];
        std::copy_n(channel, subcarriers, &found.ends[(end0 + rows[end]) * subcarriers]);
        // In units of the whole group: a perfect end would have 1/N.
        const double gain = fit.gain[end];
        if (!(gain * d_settings.group_length < worst_gain))
            continue;
        const double least = std::pow(d_settings.least_error, 2);
        found.gain[end0 + rows[end]] = gain * std::max(coherence.factor[end], ratio);
        if (least > 0)
            found.gain[end0 + rows[end]] +=
                2 * least * energy_of(channel, noise.inverse.data(), subcarriers);
        const double power =
            energy_of(channel, nullptr, subcarriers) / subcarriers - gain * level;
        found.snr_db[end0 + rows[end]] =
            10 * std::log10(std::max(d_settings.line_power * power / level, 1e-12));
    }
    for (std::size_t i = 0; i < group.tags.size(); i++) {
        const auto& tag = group.tags[i];
        const std::size_t place = tag0 + tag.index;
        found.disturbed[place] =
            coherence.disturbed[2 * i] || coherence.disturbed[2 * i + 1];
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
