// SPDX-License-Identifier: GPL-3.0-or-later
#include "press_fit.h"

#include "../clones.h"

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace gr::wiforce::kernel {

namespace {

// Steps of the fit of force and location when it ends, in nodes of the table and in mm.
constexpr double last_steps = 1e-3, last_mm = 0.02;
constexpr int most_rounds = 8;
// Of the curvature of the squared residual by that of the phases.
constexpr double most_correction = 4.0;
// deg^2, so that products over all phases are still numbers.
constexpr double least_variance = 1e-9, most_variance = 1e9;

// Force is unobservable where a phase error of 1 deg, or of the noise's size if that is
// larger, costs this much,
constexpr double unobservable_n = 0.5;
// and knowing the location would cut that by this factor.
constexpr double unobservable_ratio = 2.5;

double total_variance(const phase_reading& wanted,
                      const tabulated_model::values& at,
                      std::size_t p)
{
    return std::clamp(
        wanted.std[p] * wanted.std[p] + at.variance[p], least_variance, most_variance);
}

double wrap(double deg)
{
    const double turns = deg * (1.0 / 360);
    return deg - 360.0 * static_cast<double>(static_cast<std::int64_t>(
                             turns + std::copysign(0.5, turns)));
}

// Slopes are by force (N) and by location (mm).
bool hides_force(const tabulated_model::values& at,
                 std::size_t phases,
                 double force,
                 double std_deg)
{
    double by_force = 0, by_location = 0, both = 0;
    for (std::size_t p = 0; p < phases; p++) {
        const double f = at.by_log_force[p] / force, l = at.by_location[p];
        by_force += f * f;
        by_location += l * l;
        both += f * l;
    }
    const double determinant = by_force * by_location - both * both;
    const double spread = std::max(std_deg, 1.0);
    return by_location * spread * spread >
               unobservable_n * unobservable_n * determinant &&
           by_location * by_force > unobservable_ratio * unobservable_ratio * determinant;
}

} // namespace

bool press_fit::unobservable(double force, double location, double std_deg) const
{
    tabulated_model::values at;
    d_model.interpolate(d_model.steps_to(force), location, at);
    return hides_force(at, d_model.phases(), force, std_deg);
}

WIFORCE_CLONES
void press_fit::at_force(const phase_reading& wanted,
                         double reach_mm,
                         double tolerance_mm,
                         point& at) const
{
    const auto phases = d_model.phases();
    const double left = d_model.location_mm().front(),
                 right = d_model.location_mm().back();
    tabulated_model::values model;
    double error[tabulated_model::most_phases], variance[tabulated_model::most_phases];
    double move = 0, information = 0, gradient_before = 0;
    for (int round = 0; round < most_rounds; round++) {
        d_model.interpolate(at.steps, at.location, model);
        double gradient = 0;
        information = 0;
        for (std::size_t p = 0; p < phases; p++) {
            error[p] = wrap(wanted.phase[p] - model.phase[p]);
            variance[p] = total_variance(wanted, model, p);
            const double weighted = model.by_location[p] / variance[p];
            gradient += weighted * error[p];
            information += weighted * model.by_location[p];
        }
        if (wanted.location)
            break;
        // Gauss-Newton, then the secant: where a large residual remains, the curvature of
        // the phases counts too.
        double curvature = information;
        if (round > 0 && move != 0)
            curvature = std::clamp((gradient_before - gradient) / move,
                                   information / most_correction,
                                   information * most_correction);
        gradient_before = gradient;
        const double step =
            std::clamp(gradient / std::max(curvature, 1e-300), -reach_mm, reach_mm);
        const double to = std::clamp(at.location + step, left, right);
        move = to - at.location;
        at.location = to;
        if (std::abs(move) < tolerance_mm)
            break;
    }
    // no more can be unknown than the line is long
    information = std::max(information, 12 / ((right - left) * (right - left)));
    double largest = 0, product = wanted.location ? 1.0 : information;
    for (std::size_t p = 0; p < phases; p++) {
        at.residual[p] =
            (error[p] - model.by_location[p] * move) / std::sqrt(variance[p]);
        product *= variance[p];
        largest = std::max(largest, wanted.std[p]);
    }
    at.scale = 1 / std::sqrt(product);
    at.variance = wanted.location ? 0.0 : 1 / information;
    at.unobservable = !wanted.location && hides_force(model, phases, at.force, largest);
}

std::optional<press_fit::press>
press_fit::best(const phase_reading& wanted, double steps, double location) const
{
    const double last_step = static_cast<double>(d_model.force_n().size() - 1);
    const double left = d_model.location_mm().front(),
                 right = d_model.location_mm().back();
    tabulated_model::values at;
    for (int round = 0;; round++) {
        d_model.interpolate(steps, location, at);
        // Gauss-Newton, by nodes of force and by location
        double ff = 0, fl = 0, ll = 0, f = 0, l = 0;
        for (std::size_t p = 0; p < d_model.phases(); p++) {
            const double error = wrap(wanted.phase[p] - at.phase[p]);
            const double weight = 1 / total_variance(wanted, at, p);
            const double by_step = at.by_log_force[p] * d_model.log_force_step(),
                         by_location = wanted.location ? 0.0 : at.by_location[p];
            ff += weight * by_step * by_step;
            fl += weight * by_step * by_location;
            ll += weight * by_location * by_location;
            f += weight * by_step * error;
            l += weight * by_location * error;
        }
        if (wanted.location)
            ll = 1;
        const double determinant = ff * ll - fl * fl;
        if (!(determinant > 0))
            return std::nullopt;
        const double move = (ll * f - fl * l) / determinant;
        const double shift = (ff * l - fl * f) / determinant;
        steps += move;
        location += shift;
        if (!(steps > 0 && steps < last_step && location >= left && location <= right))
            return std::nullopt;
        if (std::abs(move) < last_steps && std::abs(shift) < last_mm) {
            const double force =
                d_model.force_n().front() * std::exp(steps * d_model.log_force_step());
            const double per_step = force * d_model.log_force_step();
            return press{ force,
                          location,
                          ll / determinant * per_step * per_step,
                          -fl / determinant * per_step,
                          wanted.location ? 0.0 : ff / determinant };
        }
        if (round == most_rounds)
            return std::nullopt;
    }
}

} // namespace gr::wiforce::kernel
