// SPDX-License-Identifier: GPL-3.0-or-later
#include "press_posterior.h"

#include "../clones.h"
#include "../require.h"

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace gr::wiforce::kernel {

namespace {

// Phases beyond this have lost their digits.
constexpr double largest_deg = 1e9;
// A dip of the likelihood by so much (squared standard deviations) parts two solutions.
constexpr double barrier = 4.0;
// Part of the posterior in which force is unobservable, from which on the reading is.
constexpr double unobservable_share = 0.2;
// Part of the posterior outside the calibrated span, below which the reading is inside,
constexpr double rim = 0.02;
// and part inside, above which a solution may be preferred for it.
constexpr double foothold = 1e-3;
// Of force (N^2) and location (mm^2): differences of sums have no more digits.
constexpr double least_variance = 1e-12;

// A posterior is compact, if its mean is this near to its mode, in standard deviations,
// and the ratio of its variance to that of phases linear in force and location is within
// this.
constexpr double compact_shift = 0.3, compact_ratio = 1.4;

bool compact(const press_fit::press& mode, const press_fit::press& mean)
{
    const double shift = mean.force - mode.force,
                 ratio = mean.force_variance / mode.force_variance;
    return shift * shift < compact_shift * compact_shift * mode.force_variance &&
           ratio < compact_ratio && ratio > 1 / compact_ratio;
}

// Up to this step of z a polynomial serves for the likelihood, to 1e-4 of it.
constexpr double small_step = 1.0;

// The integral of exp(-z^2 / 2) from 0.
double cumulated(double z) { return std::sqrt(M_PI / 2) * std::erf(std::sqrt(0.5) * z); }

// Integrals of t^0, t^1, t^2 times exp(-z^2 / 2), z from a to b while t goes from 0 to 1.
struct integrals {
    double zeroth, first, second;
};

// By the polynomial of fifth degree that has the right values, slopes and bends at both
// ends; small steps.
inline integrals of_polynomial(double a, double b, double at_a, double at_b)
{
    const double step = b - a;
    const double rise_a = -a * step * at_a, rise_b = -b * step * at_b;
    const double bend_a = (a * a - 1) * step * step * at_a,
                 bend_b = (b * b - 1) * step * step * at_b;
    return {
        (60 * (at_a + at_b) + 12 * (rise_a - rise_b) + bend_a + bend_b) * (1.0 / 120),
        (120 * at_a + 300 * at_b + 32 * rise_a - 52 * rise_b + 3 * bend_a + 4 * bend_b) *
            (1.0 / 840),
        (100 * at_a + 460 * at_b + 30 * rise_a - 70 * rise_b + 3 * bend_a + 5 * bend_b) *
            (1.0 / 1680)
    };
}

// In closed form, given the integral of the density from a to b; large steps.
inline integrals by_parts(double a, double b, double at_a, double at_b, double between)
{
    const double per_step = 1 / (b - a), zeroth = between * per_step;
    const double first = ((at_a - at_b) * per_step - a * zeroth) * per_step;
    return { zeroth, first, ((zeroth - at_b) * per_step - a * first) * per_step };
}

} // namespace

calibrated_span::calibrated_span(std::vector<double> location_mm,
                                 std::vector<double> low_n,
                                 std::vector<double> high_n)
    : d_location(std::move(location_mm)),
      d_low(std::move(low_n)),
      d_high(std::move(high_n))
{
    const auto size = d_location.size();
    require(size >= 2 && d_low.size() == size && d_high.size() == size,
            "calibrated_span: location_mm must have 2 values or more, as many as low_n "
            "and high_n",
            size);
}

bool calibrated_span::extrapolated(double force_n,
                                   double location_mm,
                                   double force_variance,
                                   double location_variance) const
{
    if (contains(force_n, location_mm))
        return false;
    const double by_n = std::sqrt(force_variance), by_mm = std::sqrt(location_variance);
    for (const double along : { -by_mm, 0.0, by_mm })
        if (reaches(force_n - by_n, force_n + by_n, location_mm + along))
            return false;
    return true;
}

bool calibrated_span::reaches(double lowest_n, double highest_n, double location_mm) const
{
    if (!(location_mm >= d_location.front() && location_mm <= d_location.back()))
        return false;
    const auto next = std::clamp<std::ptrdiff_t>(
        std::upper_bound(d_location.begin(), d_location.end(), location_mm) -
            d_location.begin(),
        1,
        static_cast<std::ptrdiff_t>(d_location.size()) - 1);
    const double part =
        (location_mm - d_location[next - 1]) / (d_location[next] - d_location[next - 1]);
    const auto at = [&](const std::vector<double>& edge) {
        return edge[next - 1] + part * (edge[next] - edge[next - 1]);
    };
    return highest_n >= at(d_low) && lowest_n <= at(d_high);
}

void press_posterior::moments::operator+=(const moments& other)
{
    mass += other.mass;
    force += other.force;
    force_2 += other.force_2;
    location += other.location;
    location_2 += other.location_2;
    product += other.product;
    unobservable += other.unobservable;
    outside += other.outside;
}

bool press_posterior::solution::inside() const
{
    return sums.mass - sums.outside > foothold * sums.mass;
}

press_posterior::press_posterior(tabulated_model model,
                                 calibrated_span span,
                                 double consistent)
    : d_profile(std::move(model), consistent), d_span(std::move(span))
{
}

void press_posterior::add(const workspace& work, std::size_t segment, moments& to) const
{
    const auto point = work.curve.segments[segment].point;
    const auto& from = work.curve.points[point];
    const auto& end = work.curve.points[point + 1];
    const auto& by = work.weight[segment];
    const double larger = work.curve.inflation;
    const double a = by.left, b = by.right, rise = end.force - from.force,
                 shift = end.location - from.location;
    to.mass += a + b;
    to.force += a * from.force + b * end.force;
    to.force_2 +=
        a * from.force * from.force + b * end.force * end.force - by.bend * rise * rise;
    to.location += a * from.location + b * end.location;
    to.location_2 += a * (from.location * from.location + larger * from.variance) +
                     b * (end.location * end.location + larger * end.variance) -
                     by.bend * shift * shift;
    to.product += a * from.force * from.location + b * end.force * end.location -
                  by.bend * rise * shift;
    to.unobservable += a * from.unobservable + b * end.unobservable;
    to.outside += a * work.outside[point] + b * work.outside[point + 1];
}

press_fit::press press_posterior::mean(const moments& solution, const moments& all)
{
    const double f = solution.force / solution.mass,
                 l = solution.location / solution.mass;
    const auto about =
        [&](double square, double a, double sum_a, double b, double sum_b) {
            return (square - a * sum_b - b * sum_a) / all.mass + a * b;
        };
    return { f,
             l,
             std::max(about(all.force_2, f, all.force, f, all.force), least_variance),
             about(all.product, f, all.force, l, all.location),
             std::max(about(all.location_2, l, all.location, l, all.location),
                      least_variance) };
}

std::optional<press_fit::press>
press_posterior::mode_near(const phase_reading& wanted,
                           const likelihood_profile::curve& drawn,
                           std::size_t segment) const
{
    const auto& near = drawn.segments[segment];
    const auto &from = drawn.points[near.point], &to = drawn.points[near.point + 1];
    const double length = near.z_to - near.z_from;
    const double along = length > 0 ? std::clamp(-near.z_from / length, 0.0, 1.0) : 0.5;
    auto found =
        d_profile.fit().best(wanted,
                             from.steps + along * (to.steps - from.steps),
                             from.location + along * (to.location - from.location));
    if (found) {
        found->force_variance *= drawn.inflation;
        found->covariance *= drawn.inflation;
        found->location_variance *= drawn.inflation;
    }
    return found;
}

WIFORCE_CLONES
void press_posterior::integrate(workspace& work) const
{
    const auto& segments = work.curve.segments;
    const auto& points = work.curve.points;
    const auto count = segments.size();
    const double smaller = 1 / std::sqrt(work.curve.inflation);
    work.outside.resize(points.size());
    for (std::size_t i = 0; i < points.size(); i++)
        work.outside[i] = !d_span.contains(points[i].force, points[i].location);
    // z at both ends of every segment, and the root of what remains
    work.z.resize(3 * count);
    work.density.resize(3 * count);
    work.weight.resize(count);
    for (std::size_t s = 0; s < count; s++) {
        work.z[s] = smaller * segments[s].z_from;
        work.z[count + s] = smaller * segments[s].z_to;
        work.z[2 * count + s] = smaller * std::sqrt(segments[s].rest);
    }
    for (std::size_t i = 0; i < 3 * count; i++)
        work.density[i] = std::exp(-0.5 * work.z[i] * work.z[i]);
    for (std::size_t s = 0; s < count; s++) {
        const double a = work.z[s], b = work.z[count + s];
        const double at_a = work.density[s], at_b = work.density[count + s];
        const auto part = b - a > small_step
                              ? by_parts(a, b, at_a, at_b, cumulated(b) - cumulated(a))
                              : of_polynomial(a, b, at_a, at_b);
        const auto& from = points[segments[s].point];
        const auto& end = points[segments[s].point + 1];
        const double scale = work.density[2 * count + s] * (end.steps - from.steps) *
                             (from.scale + end.scale);
        work.weight[s] = { scale * (part.zeroth - part.first),
                           scale * part.first,
                           scale * (part.first - part.second) };
    }
}

void press_posterior::find_solutions(workspace& work) const
{
    const double inflation = work.curve.inflation;
    const auto& segments = work.curve.segments;
    work.solutions.clear();
    for (std::size_t first = 0, last; first < segments.size(); first = last) {
        last = first + 1;
        double best = segments[first].misfit;
        for (; last < segments.size() && segments[last].branch == segments[first].branch;
             last++)
            best = std::min(best, segments[last].misfit);
        // runs of likely segments; what lies between belongs to the run before
        bool any = false, likely_before = false;
        work.solutions.push_back({ {}, segments[first].misfit / inflation, first });
        for (auto s = first; s < last; s++) {
            const double misfit = segments[s].misfit / inflation;
            const bool likely = misfit < best / inflation + barrier;
            if (likely && !likely_before && any)
                work.solutions.push_back({ {}, misfit, s });
            any = any || likely;
            likely_before = likely;
            auto& found = work.solutions.back();
            add(work, s, found.sums);
            if (misfit < found.misfit) {
                found.misfit = misfit;
                found.best = s;
            }
        }
    }
    // what does not fit is no solution, however likely the calibrated span makes it
    work.solutions.erase(std::remove_if(work.solutions.begin(),
                                        work.solutions.end(),
                                        [&](const solution& s) {
                                            return s.misfit > d_profile.consistent();
                                        }),
                         work.solutions.end());
}

const press_posterior::solution& press_posterior::choose(const workspace& work) const
{
    return *std::max_element(
        work.solutions.begin(), work.solutions.end(), [](const auto& a, const auto& b) {
            return a.inside() == b.inside() ? a.sums.mass < b.sums.mass : b.inside();
        });
}

std::uint8_t press_posterior::invert(const phase_reading& wanted,
                                     workspace& work,
                                     press_fit::press& out) const
{
    out = { NAN, NAN, NAN, NAN, NAN };
    for (std::size_t p = 0; p < phases(); p++)
        if (!(std::abs(wanted.phase[p]) < largest_deg) || std::isnan(wanted.std[p]) ||
            (wanted.shared && !std::isfinite(wanted.shared[p])))
            return inconsistent;
    if (wanted.location && !std::isfinite(*wanted.location))
        return inconsistent;
    d_profile.draw(wanted, work.curve);
    integrate(work);
    find_solutions(work);
    const auto& chosen = choose(work);
    const bool fits = work.curve.inflation == 1;
    std::uint8_t flags = fits ? 0 : inconsistent;
    moments all;
    const auto branch = [&](const solution& s) {
        return work.curve.segments[s.best].branch;
    };
    for (const auto& found : work.solutions) {
        // the calibrated span decides between branches
        if (chosen.inside() && !found.inside() && branch(found) != branch(chosen))
            continue;
        all += found.sums;
        if (fits && &found != &chosen && found.misfit < chosen.misfit + barrier)
            flags |= ambiguous;
    }
    out = mean(chosen.sums, all);
    if (wanted.location)
        out = { out.force, *wanted.location, out.force_variance, 0, 0 };
    if (!(flags & ambiguous)) {
        const auto mode = mode_near(wanted, work.curve, chosen.best);
        if (mode && compact(*mode, out))
            out = *mode;
        else if (mode && wanted.location) {
            // The force of least squares, which published figures are given for.
            const double shift = mode->force - out.force;
            out.force = mode->force;
            out.force_variance += shift * shift;
        }
    }
    if (all.unobservable > unobservable_share * all.mass)
        flags |= force_unobservable;
    if (all.outside > rim * all.mass &&
        d_span.extrapolated(
            out.force, out.location, out.force_variance, out.location_variance))
        flags |= extrapolated;
    return flags;
}

} // namespace gr::wiforce::kernel
