// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace gr::wiforce::kernel {

/*!
 * \brief Phases of a sensor over force and location, interpolated from a table.
 *
 * Nodes are equally spaced in the logarithm of force and in location. Between them the
 * phases are bicubic (Hermite's form, from the phases and their derivatives at the nodes)
 * and their variances bilinear.
 */
class tabulated_model
{
public:
    //! Numbers per phase and node: the phase (deg, not wrapped), its derivatives by the
    //! logarithm of force, by location (mm) and by both, and its variance (deg^2).
    static constexpr std::size_t columns = 5;
    static constexpr std::size_t most_phases = 32;

    //! The model at one force and location; the first `phases()` of each are set.
    struct values {
        double phase[most_phases], by_log_force[most_phases], by_location[most_phases],
            variance[most_phases];
    };

    /*!
     * \param force_n rising nodes of one ratio
     * \param location_mm rising nodes of one spacing
     * \param table forces x locations x phases x columns
     */
    tabulated_model(std::vector<double> force_n,
                    std::vector<double> location_mm,
                    const std::vector<double>& table);

    std::size_t phases() const { return d_phases; }
    const std::vector<double>& force_n() const { return d_force; }
    const std::vector<double>& location_mm() const { return d_location; }
    double log_force_step() const { return d_log_step; }

    //! The phase at a node of the table.
    double at_node(std::size_t force, std::size_t location, std::size_t phase) const
    {
        return d_phase[((force * d_location.size() + location) * d_phases + phase) * 4];
    }

    //! Interpolates `steps` nodes above the first force; both within the table.
    void interpolate(double steps, double location_mm, values& out) const;

    //! Steps of the nodes from the first force to this one.
    double steps_to(double force_n) const;

private:
    std::vector<double> d_force, d_location;
    std::size_t d_phases;
    double d_log_step, d_location_step;
    std::vector<double> d_phase; // and its derivatives, per step of the nodes
    std::vector<double> d_variance;
};

} // namespace gr::wiforce::kernel
