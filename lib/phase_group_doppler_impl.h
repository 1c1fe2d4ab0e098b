// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "doppler_transform.h"
#include <gnuradio/wiforce/phase_group_doppler.h>

#include <memory>

namespace gr::wiforce {

class phase_group_doppler_impl : public phase_group_doppler
{
public:
    phase_group_doppler_impl(std::unique_ptr<doppler_transform> transform,
                             int group_length);

    void forecast(int noutput_items, gr_vector_int& ninput_items_required) override;
    int general_work(int noutput_items,
                     gr_vector_int& ninput_items,
                     gr_vector_const_void_star& input_items,
                     gr_vector_void_star& output_items) override;

    int rows() const override { return d_transform->rows(); }
    std::uint64_t groups() const override { return d_groups; }
    std::uint64_t incomplete_groups() const override { return d_incomplete_groups; }

private:
    // Ends the group at hand; returns whether it was emitted to `out`.
    bool close_group(kernel::fc32* out, int produced);
    void publish_incomplete() const;
    bool starts_new_group(std::uint64_t snapshot) const;

    const std::unique_ptr<doppler_transform> d_transform;
    kernel::phase_group d_group;
    std::uint64_t d_index = 0;    // of the group at hand
    std::uint64_t d_snapshot = 0; // of the next input item

    std::uint64_t d_groups = 0;
    std::uint64_t d_incomplete_groups = 0;
};

} // namespace gr::wiforce
