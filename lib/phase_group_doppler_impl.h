// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "group_block.h"
#include "tag_values.h"
#include <gnuradio/wiforce/phase_group_doppler.h>

namespace gr::wiforce {

class phase_group_doppler_impl : public group_block<phase_group_doppler>
{
public:
    phase_group_doppler_impl(std::unique_ptr<kernel::doppler_transform> transform,
                             int group_length,
                             int symbol_length);

    void forecast(int noutput_items, gr_vector_int& ninput_items_required) override;
    int general_work(int noutput_items,
                     gr_vector_int& ninput_items,
                     gr_vector_const_void_star& input_items,
                     gr_vector_void_star& output_items) override;

    bool start() override;
    int rows() const override { return d_collector.rows(); }
    std::uint64_t groups() const override { return d_groups; }
    std::uint64_t incomplete_groups() const override { return d_incomplete_groups; }

private:
    // Tags of so many input items.
    std::vector<gr::tag_t>
    tags_among(int count, std::uint64_t first, const pmt::pmt_t& key);

    void collect_noise(int available);

    const int d_symbol_length;
    std::uint64_t d_snapshot = 0; // of the next input item
    noise_tags d_noise;
    std::uint64_t d_noise_read_to = 0; // input offset up to which its tags were read
};

} // namespace gr::wiforce
