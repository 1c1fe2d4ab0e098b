// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "../types.h"

#include <cstddef>
#include <vector>

namespace gr::wiforce::kernel {

/*
 * Folds the repeated part of each sounding frame into its mean: one symbol per frame.
 *
 *   folded[n] = 1/R sum_r x[first_averaged + N r + n],  n = 0..N-1, r = 0..R-1
 *
 * sc16 samples are summed as integers, which is exact, and scaled by 1/32768, so that
 * both sample types give the same unit. It knows the layout of one frame only; frame_walk
 * handles alignment and lost samples. Samples outside the averaged part are never read.
 */
class preamble_folder
{
public:
    // Throws std::invalid_argument unless 0 <= first_averaged, 1 <= repetitions, the
    // symbol has 16 to 4096 samples and first_averaged + symbol_length repetitions <=
    // frame_length.
    preamble_folder(int frame_length,
                    int first_averaged = 64,
                    int repetitions = 4,
                    int symbol_length = DEFAULT_SYMBOL_LENGTH);

    int frame_length() const { return d_frame_length; }
    int first_averaged() const { return d_first_averaged; }
    int symbol_length() const { return d_symbol_length; }
    int averaged_length() const { return d_repetitions * d_symbol_length; }

    // `averaged` is the first averaged sample of the first frame; frames follow each
    // other at frame_length. Writes symbol_length * frames values, the noise of each
    // frame and, to `saturated`, the frames that hold averaged samples at a converter's
    // full scale, 1 for floats (none where they exceed it), or at a lower limit.
    // Allocates nothing where it has room for all frames.
    template <class Sample> // fc32 or sc16
    void fold(const Sample* averaged,
              std::size_t frames,
              fc32* folded,
              snapshot_noise* noise,
              std::vector<int>& saturated) const;

private:
    const int d_frame_length;
    const int d_first_averaged;
    const int d_repetitions;
    const int d_symbol_length;
};

} // namespace gr::wiforce::kernel
