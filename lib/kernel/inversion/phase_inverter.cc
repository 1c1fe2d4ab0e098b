// SPDX-License-Identifier: GPL-3.0-or-later
#include "phase_inverter.h"

#include <algorithm>
#include <cmath>
#include <system_error>
#include <thread>
#include <vector>

namespace gr::wiforce::kernel {

namespace {

// Phases beyond this have lost their digits.
constexpr double largest_deg = 1e9;
// Part of the likelihood that lies where force is hidden, from which on it counts as
// hidden.
constexpr double mostly = 0.2;
// Part of it outside the calibrated span, below which the solution is not.
constexpr double rim = 0.02;
// Up to this misfit (squared standard deviations) the integrals keep their digits.
constexpr double integrable = 25.0;

// Readings that are worth starting a thread for (50 us).
constexpr std::size_t thread_share = 2000;

// Two turns of phase that explain a reading.
likelihood_profile::reading either(const likelihood_profile::reading& one,
                                   const likelihood_profile::reading& other)
{
    const auto inside = [](const auto& r) { return r.outside < 0.5; };
    // the calibrated span decides between solutions that fit alike
    if (inside(one) != inside(other))
        return inside(one) ? one : other;
    const bool first = one.misfit <= other.misfit;
    auto chosen = first ? one : other;
    const auto& rival = first ? other : one;
    const double force = rival.force - chosen.force,
                 place = rival.location - chosen.location;
    chosen.force_variance += force * force / 2;
    chosen.location_variance += place * place / 2;
    chosen.covariance += force * place / 2;
    chosen.ambiguous = 1;
    return chosen;
}

} // namespace

phase_inverter::phase_inverter(inverse_table table,
                               std::shared_ptr<const likelihood_profile> profile,
                               calibrated_span span,
                               limits limits)
    : d_table(std::move(table)),
      d_profile(std::move(profile)),
      d_span(std::move(span)),
      d_limits(limits)
{
}

bool phase_inverter::in_domain(double force, double location) const
{
    return force >= d_limits.low_n && force <= d_limits.high_n &&
           location >= d_limits.left_mm && location <= d_limits.right_mm;
}

std::uint8_t phase_inverter::read(
    double psi_1, double psi_2, double std_1, double std_2, reading& out) const
{
    if (!(std::abs(psi_1) < largest_deg && std::abs(psi_2) < largest_deg)) {
        out = { NAN, NAN, { NAN, NAN, NAN, NAN } };
        return inconsistent;
    }
    const auto found = d_table.read(psi_1, psi_2, std_1, std_2);
    if (!found || !in_domain(found->force, found->location))
        return profiled(psi_1, psi_2, std_1, std_2, out);
    out = { found->force,
            found->location,
            { found->force_variance,
              found->covariance,
              found->covariance,
              found->location_variance } };
    std::uint8_t flags = found->hidden ? unobservable : 0;
    if (!found->in_span && d_span.extrapolated(found->force,
                                               found->location,
                                               found->force_variance,
                                               found->location_variance))
        flags |= extrapolated;
    return flags;
}

void phase_inverter::read_all(const double* psi,
                              const double* std,
                              std::size_t count,
                              reading* out,
                              std::uint8_t* flags) const
{
    const auto read_some = [=](std::size_t first, std::size_t last) {
        for (std::size_t i = first; i < last; i++)
            flags[i] =
                read(psi[2 * i], psi[2 * i + 1], std[2 * i], std[2 * i + 1], out[i]);
    };
    const std::size_t processors = std::max(std::thread::hardware_concurrency(), 1U);
    const std::size_t parts =
        std::clamp(count / thread_share, std::size_t{ 1 }, processors);
    const auto begin = [=](std::size_t part) { return part * count / parts; };
    std::vector<std::thread> others;
    try {
        while (others.size() + 1 < parts) {
            const auto part = others.size() + 1;
            others.emplace_back(read_some, begin(part), begin(part + 1));
        }
    } catch (const std::system_error&) {
        // No more threads are to be had: the rest is read here.
    }
    read_some(0, begin(1));
    read_some(begin(others.size() + 1), count);
    for (auto& other : others)
        other.join();
}

std::uint8_t phase_inverter::profiled(
    double psi_1, double psi_2, double std_1, double std_2, reading& out) const
{
    const auto turns = d_profile->read_turns(psi_1, psi_2, std_1 * std_1, std_2 * std_2);
    if (turns.count == 0)
        return unknown;
    auto found = turns.first;
    if (turns.count == 2) {
        const bool fits = turns.first.misfit <= d_limits.misfit,
                   other_fits = turns.second.misfit <= d_limits.misfit;
        if (fits && other_fits)
            found = either(turns.first, turns.second);
        else if (turns.second.misfit < turns.first.misfit)
            found = turns.second;
    }
    if (!(found.misfit <= integrable))
        return unknown;
    std::uint8_t flags = 0;
    if (found.misfit > d_limits.misfit) {
        flags |= inconsistent;
        const double more = found.misfit / d_limits.misfit;
        found.force_variance *= more;
        found.location_variance *= more;
        found.covariance *= more;
    }
    if (found.ambiguous > 0)
        flags |= ambiguous;
    if (found.hidden > mostly)
        flags |= unobservable;
    if (found.outside > rim &&
        d_span.extrapolated(
            found.force, found.location, found.force_variance, found.location_variance))
        flags |= extrapolated;
    out = { found.force,
            found.location,
            { found.force_variance,
              found.covariance,
              found.covariance,
              found.location_variance } };
    return flags;
}

} // namespace gr::wiforce::kernel
