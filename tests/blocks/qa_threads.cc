// SPDX-License-Identifier: GPL-3.0-or-later
// Flowgraphs that run while another thread asks them, stops them and starts them again.
// What can go wrong here shows under the thread sanitizer: ./bootstrap sanitize
#include <gnuradio/io_signature.h>
#include <gnuradio/sync_block.h>
#include <gnuradio/top_block.h>
#include <gnuradio/wiforce/names.h>
#include <gnuradio/wiforce/ofdm_channel_estimator.h>
#include <gnuradio/wiforce/phase_group_doppler.h>
#include <gnuradio/wiforce/preamble_fold.h>
#include <gnuradio/wiforce/recording_source.h>

#include <boost/test/unit_test.hpp>

#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <thread>
#include <unistd.h>

using namespace gr::wiforce;

namespace {

constexpr int GROUP = 25;
constexpr int FRAME = 720;
constexpr std::size_t VECTOR_BYTES = 64 * sizeof(gr_complex);

// Samples without end, some lost before every call, as their rx_time tells.
class losing_source : public gr::sync_block
{
public:
    losing_source()
        : gr::sync_block("losing_source",
                         gr::io_signature::make(0, 0, 0),
                         gr::io_signature::make(1, 1, sizeof(gr_complex)))
    {
    }

    int work(int count, gr_vector_const_void_star&, gr_vector_void_star& output) override
    {
        std::fill_n(static_cast<gr_complex*>(output[0]), count, gr_complex(0.5f, -0.5f));
        d_lost += 100;
        const std::uint64_t at = nitems_written(0) + d_lost;
        add_item_tag(0,
                     nitems_written(0),
                     pmt::mp("rx_time"),
                     pmt::make_tuple(pmt::from_uint64(at / 12'500'000),
                                     pmt::from_double(at % 12'500'000 / 12.5e6)));
        return count;
    }

private:
    std::uint64_t d_lost = 0;
};

class count_sink : public gr::sync_block
{
public:
    explicit count_sink(std::size_t item)
        : gr::sync_block("count_sink",
                         gr::io_signature::make(1, 1, item),
                         gr::io_signature::make(0, 0, 0))
    {
    }

    int work(int count, gr_vector_const_void_star&, gr_vector_void_star&) override
    {
        items += count;
        return count;
    }

    std::atomic<std::uint64_t> items{ 0 };
};

std::vector<std::complex<double>> weights(int rows)
{
    return std::vector<std::complex<double>>(rows * GROUP, 1.0 / GROUP);
}

// Runs until so many items have come out, and asks all the while.
template <class Ask>
void run(gr::top_block_sptr flowgraph, const count_sink& sink, int items, Ask ask)
{
    flowgraph->start();
    const std::uint64_t wanted = sink.items + items;
    while (sink.items < wanted)
        ask();
    flowgraph->stop();
    flowgraph->wait();
}

} // namespace

BOOST_AUTO_TEST_CASE(a_chain_of_samples_may_be_asked_stopped_and_started_at_any_time)
{
    constexpr int rows = 3;
    const auto flowgraph = gr::make_top_block("samples");
    const auto source = gnuradio::make_block_sptr<losing_source>();
    const auto fold = preamble_fold::tones(weights(rows), GROUP, FRAME);
    const auto estimator =
        ofdm_channel_estimator::make(std::vector<std::complex<double>>(64, 1.0), rows);
    const auto sink = gnuradio::make_block_sptr<count_sink>(rows * VECTOR_BYTES);
    flowgraph->connect(source, 0, fold, 0);
    flowgraph->connect(fold, 0, estimator, 0);
    flowgraph->connect(estimator, 0, sink, 0);
    std::uint64_t snapshots = 0, lost = 0, gaps = 0;
    for (int again = 0; again < 3; again++)
        run(flowgraph, *sink, 50, [&] {
            BOOST_REQUIRE(fold->snapshots() >= snapshots);
            BOOST_REQUIRE(fold->samples_lost() >= lost);
            BOOST_REQUIRE(fold->gaps() >= gaps);
            snapshots = fold->snapshots();
            lost = fold->samples_lost();
            gaps = fold->gaps();
        });
    BOOST_TEST(fold->snapshots() > 0);
    BOOST_TEST(fold->gaps() > 0);
}

BOOST_AUTO_TEST_CASE(a_chain_of_folded_vectors_may_be_asked_at_any_time)
{
    constexpr int rows = 3;
    const auto flowgraph = gr::make_top_block("vectors");
    const auto source = gnuradio::make_block_sptr<losing_source>();
    const auto fold = preamble_fold::make(FRAME);
    const auto doppler = phase_group_doppler::make(weights(rows), GROUP);
    const auto sink = gnuradio::make_block_sptr<count_sink>(rows * VECTOR_BYTES);
    flowgraph->connect(source, 0, fold, 0);
    flowgraph->connect(fold, 0, doppler, 0);
    flowgraph->connect(doppler, 0, sink, 0);
    std::uint64_t groups = 0;
    run(flowgraph, *sink, 100, [&] {
        BOOST_REQUIRE(doppler->groups() >= groups);
        groups = doppler->groups();
        const std::uint64_t incomplete = doppler->incomplete_groups();
        BOOST_REQUIRE(incomplete <= doppler->groups());
    });
    BOOST_TEST(doppler->incomplete_groups() > 0);
}

BOOST_AUTO_TEST_CASE(a_recording_may_be_cut_and_asked_while_it_is_read)
{
    constexpr std::uint64_t samples = 40'000ull * FRAME;
    char path[] = "/tmp/wiforce-threads-XXXXXX";
    close(mkstemp(path));
    BOOST_REQUIRE(truncate(path, 4 * samples) == 0);
    const auto flowgraph = gr::make_top_block("recording");
    const auto source = recording_source::make(
        path, "ci16_le", { { 0, 0, samples } }, FRAME, 64, 4, 0, 0);
    const auto sink = gnuradio::make_block_sptr<count_sink>(VECTOR_BYTES);
    flowgraph->connect(source, 0, sink, 0);
    flowgraph->start();
    std::thread asking([&] {
        while (source->snapshots() < 1000)
            BOOST_REQUIRE(source->samples_missing() <= samples);
        BOOST_REQUIRE(truncate(path, 2 * samples) == 0);
    });
    flowgraph->wait();
    asking.join();
    unlink(path);
    const std::uint64_t held = samples - source->samples_missing();
    // The last frame needs its averaged samples, not its guard.
    BOOST_TEST(source->snapshots() == (held + FRAME - 64 - 256) / FRAME);
}
