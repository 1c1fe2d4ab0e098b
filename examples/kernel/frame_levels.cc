// SPDX-License-Identifier: GPL-3.0-or-later
// Prints the level and the noise of the sounding frames in a file of 16-bit samples.
#include <gnuradio/wiforce/kernel/recording/readers.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <limits>

namespace kernel = gr::wiforce::kernel;

namespace {

constexpr std::size_t FRAMES_PER_LINE = 1000;

// Full scale is 1.
double decibels(double power) { return 10 * std::log10(power); }

void print_levels(const char* path, int frame_length)
{
    const std::vector<kernel::recording::segment> whole_file = {
        { 0, 0, std::numeric_limits<std::uint64_t>::max() }
    };
    kernel::folded_reader reader(std::make_unique<kernel::recorded_frames>(
        path, "ci16_le", whole_file, kernel::preamble_folder(frame_length), 0, 0));
    while (true) {
        const auto batch = reader.read(FRAMES_PER_LINE);
        if (batch.snapshot.empty())
            return;
        double level = 0;
        double noise = 0;
        for (const kernel::fc32& sample : batch.folded)
            level += std::norm(sample);
        for (const kernel::snapshot_noise& frame : batch.noise)
            noise += frame.smallest;
        std::printf("frames %lld to %lld: level %.2f dBFS, noise %.2f dBFS\n",
                    static_cast<long long>(batch.snapshot.front()),
                    static_cast<long long>(batch.snapshot.back()),
                    decibels(level / batch.folded.size()),
                    decibels(noise / batch.noise.size()));
    }
}

} // namespace

int main(int argc, char** argv)
{
    if (argc != 3) {
        std::fprintf(stderr, "usage: %s FILE.sigmf-data FRAME_LENGTH\n", argv[0]);
        return 2;
    }
    try {
        print_levels(argv[1], std::atoi(argv[2]));
    } catch (const std::exception& error) {
        std::fprintf(stderr, "%s\n", error.what());
        return 1;
    }
}
