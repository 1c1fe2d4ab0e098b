// SPDX-License-Identifier: GPL-3.0-or-later
#include "preamble_fold_impl.h"

#include "kernel/require.h"
#include <gnuradio/io_signature.h>
#include <gnuradio/wiforce/names.h>

#include <algorithm>
#include <cmath>

namespace gr::wiforce {

namespace {

constexpr int INPUT_BUFFER_BYTES = 1 << 20;

const pmt::pmt_t snapshot_key = pmt::mp(names::SNAPSHOT);
const pmt::pmt_t saturated_key = pmt::mp(names::SATURATED);
const pmt::pmt_t retuned_key = pmt::mp(names::RETUNED);

void check(double sample_rate, const std::string& item_type)
{
    const char* where = "preamble_fold";
    kernel::require(std::isfinite(sample_rate) && sample_rate > 0,
                    where,
                    "sample_rate",
                    "must be positive",
                    sample_rate);
    kernel::require(item_type == "fc32" || item_type == "sc16",
                    where,
                    "item_type",
                    "must be 'fc32' or 'sc16'",
                    "'" + item_type + "'");
}

template <template <class> class Fold, class... Arguments>
preamble_fold::sptr for_items(const std::string& item_type, Arguments&&... arguments)
{
    if (item_type == "sc16")
        return gnuradio::make_block_sptr<Fold<kernel::sc16>>(
            std::forward<Arguments>(arguments)...);
    return gnuradio::make_block_sptr<Fold<kernel::fc32>>(
        std::forward<Arguments>(arguments)...);
}

} // namespace

preamble_fold::sptr preamble_fold::make(int frame_length,
                                        int first_averaged,
                                        int repetitions,
                                        double sample_rate,
                                        std::uint64_t frame_offset,
                                        const std::string& item_type)
{
    const kernel::preamble_folder folder(frame_length, first_averaged, repetitions);
    check(sample_rate, item_type);
    return for_items<vector_fold>(item_type, folder, sample_rate, frame_offset);
}

preamble_fold::sptr preamble_fold::tones(const std::vector<std::complex<double>>& weights,
                                         int group_length,
                                         int frame_length,
                                         int first_averaged,
                                         int repetitions,
                                         double sample_rate,
                                         std::uint64_t frame_offset,
                                         const std::string& item_type)
{
    const kernel::preamble_folder folder(frame_length, first_averaged, repetitions);
    check(sample_rate, item_type);
    return for_items<tone_fold>(item_type,
                                folder,
                                sample_rate,
                                frame_offset,
                                std::make_unique<doppler_tones>(weights, group_length),
                                group_length);
}

template <class Sample>
preamble_fold_impl<Sample>::preamble_fold_impl(const kernel::preamble_folder& folder,
                                               double sample_rate,
                                               std::uint64_t frame_offset)
    : d_folder(folder),
      d_first_window(frame_offset + folder.first_averaged()),
      d_events(sample_rate, this->d_logger),
      d_watch(folder.frame_length(), frame_offset)
{
    // The scheduler gives the block before this one a buffer of twice what relative_rate
    // says is needed for one output. With its default of 8192 samples it would spend its
    // time switching threads; a megabyte stays in the second cache. Nothing else looks at
    // the rate, since tags are not propagated, and small packets are still taken as they
    // come.
    set_relative_rate(1, INPUT_BUFFER_BYTES / 2 / sizeof(Sample));
    set_tag_propagation_policy(TPP_DONT);
}

// One window is enough to work on; whatever else has arrived is taken along.
template <class Sample>
void preamble_fold_impl<Sample>::forecast(int, gr_vector_int& ninput_items_required)
{
    ninput_items_required[0] = d_folder.averaged_length();
}

template <class Sample>
std::uint64_t preamble_fold_impl<Sample>::window_start() const
{
    return d_first_window + d_frame * d_folder.frame_length();
}

template <class Sample>
void preamble_fold_impl<Sample>::collect_tags(int available)
{
    const std::uint64_t begin = std::max(d_tags_read_to, this->nitems_read(0));
    const std::uint64_t end = this->nitems_read(0) + available;
    if (end <= begin)
        return;
    std::vector<gr::tag_t> tags;
    this->get_tags_in_range(tags, 0, begin, end);
    d_tags_read_to = end;
    d_events.add(std::move(tags));
}

template <class Sample>
void preamble_fold_impl<Sample>::take_event(const input_events::event& event)
{
    if (event.usable && !d_usable)
        mark_retuned();
    d_usable = event.usable;
    d_samples_lost += event.lost;
    d_gaps += event.lost > 0;
    skip(event.lost);
}

// Samples were lost or repeated of which no tag told, or a tag told wrong: how many is
// known but for whole frames.
template <class Sample>
void preamble_fold_impl<Sample>::follow_frames()
{
    const int shift = d_watch.decide();
    if (shift == 0)
        return;
    d_logger->warn("frames come {:d} samples late: followed", shift);
    const std::uint64_t lost = d_folder.frame_length() - shift;
    d_events.foretell(lost, d_folder.frame_length());
    d_frames_moved += 1;
    d_samples_moved += lost;
    skip(lost);
}

// The stream goes on so many samples later.
template <class Sample>
void preamble_fold_impl<Sample>::skip(std::uint64_t lost)
{
    d_position += lost;
    catch_up();
    d_watch.restart(d_position);
}

// Moves on to the first frame of the grid that is still whole.
template <class Sample>
void preamble_fold_impl<Sample>::catch_up()
{
    if (d_position > window_start()) {
        const std::uint64_t stride = d_folder.frame_length();
        d_frame = (d_position - d_first_window + stride - 1) / stride;
    }
}

template <class Sample>
int preamble_fold_impl<Sample>::general_work(int noutput_items,
                                             gr_vector_int& ninput_items,
                                             gr_vector_const_void_star& input_items,
                                             gr_vector_void_star& output_items)
{
    const auto* in = static_cast<const Sample*>(input_items[0]);
    d_out = static_cast<kernel::fc32*>(output_items[0]);
    d_room = noutput_items;
    d_produced = 0;
    const std::uint64_t available = ninput_items[0];
    const std::uint64_t stride = d_folder.frame_length();
    const std::uint64_t window = d_folder.averaged_length();
    const std::uint64_t first = this->nitems_read(0);
    collect_tags(ninput_items[0]);

    std::uint64_t consumed = 0;
    const auto advance = [&](std::uint64_t samples) {
        if (d_usable)
            d_watch.take(in + consumed, samples, d_position);
        consumed += samples;
        d_position += samples;
    };
    while (true) {
        std::uint64_t end = available;
        const bool decides =
            d_usable && d_watch.decision() - d_position <= end - consumed;
        if (decides)
            end = consumed + (d_watch.decision() - d_position);
        const auto& event = d_events.next(first + end);
        const bool changes = event.has_value();
        if (changes)
            end = event->item - first;

        if (!d_usable) {
            advance(end - consumed);
            catch_up();
        }
        advance(std::min(end - consumed, window_start() - d_position));
        const bool at_window = d_position == window_start();
        const std::uint64_t whole = at_window && end - consumed >= window
                                        ? 1 + (end - consumed - window) / stride
                                        : 0;
        if (whole > 0) {
            const int frames =
                d_produced < d_room ? this->take(in + consumed, whole, d_frame) : 0;
            if (frames == 0) // output is full
                break;
            advance((frames - 1) * stride + window);
            d_frame += frames;
            d_snapshots += frames;
            continue;
        }
        if (!changes && !decides)
            break;
        advance(end - consumed); // what is left of a frame that it cuts
        if (changes) {
            take_event(*event);
            d_events.drop();
        } else {
            follow_frames();
        }
    }
    this->consume_each(consumed);
    return d_produced;
}

template <class Sample>
vector_fold<Sample>::vector_fold(const kernel::preamble_folder& folder,
                                 double sample_rate,
                                 std::uint64_t frame_offset)
    : gr::block("preamble_fold",
                gr::io_signature::make(1, 1, sizeof(Sample)),
                gr::io_signature::make(1, 1, FOLDED_BYTES)),
      preamble_fold_impl<Sample>(folder, sample_rate, frame_offset)
{
}

template <class Sample>
int vector_fold<Sample>::take(const Sample* averaged, int frames, std::uint64_t snapshot)
{
    const int count = std::min(frames, this->d_room - this->d_produced);
    if (d_expected != snapshot)
        this->add_item_tag(0,
                           this->nitems_written(0) + this->d_produced,
                           snapshot_key,
                           pmt::from_uint64(snapshot));
    if (d_retuned)
        this->add_item_tag(0,
                           this->nitems_written(0) + this->d_produced,
                           retuned_key,
                           pmt::from_uint64(1));
    d_retuned = false;
    this->d_folder.fold(
        averaged, count, this->d_out + this->d_produced * kernel::FFT_LENGTH);
    this->d_folder.saturated(averaged, count, this->d_saturated);
    for (const int frame : this->d_saturated)
        this->add_item_tag(0,
                           this->nitems_written(0) + this->d_produced + frame,
                           saturated_key,
                           pmt::from_uint64(1));
    this->d_produced += count;
    d_expected = snapshot + count;
    return count;
}

template <class Sample>
tone_fold<Sample>::tone_fold(const kernel::preamble_folder& folder,
                             double sample_rate,
                             std::uint64_t frame_offset,
                             std::unique_ptr<doppler_transform> transform,
                             int group_length)
    : gr::block("preamble_fold",
                gr::io_signature::make(1, 1, sizeof(Sample)),
                gr::io_signature::make(1, 1, transform->rows() * FOLDED_BYTES)),
      group_block<preamble_fold_impl<Sample>>(
          std::move(transform), group_length, folder, sample_rate, frame_offset)
{
}

template <class Sample>
int tone_fold<Sample>::take(const Sample* averaged, int frames, std::uint64_t snapshot)
{
    auto& stream = this->d_stream;
    if (stream.must_close_before(snapshot)) {
        this->d_produced += this->close_group(this->d_out, this->d_produced);
        if (this->d_produced == this->d_room)
            return 0;
    }
    const int count = std::min({ frames, BATCH, stream.room(snapshot) });
    this->d_folder.fold(averaged, count, stream.reserve(snapshot));
    stream.accept(count);
    this->d_folder.saturated(averaged, count, this->d_saturated);
    stream.note_saturated(this->d_saturated.size());
    if (stream.is_full())
        this->d_produced += this->close_group(this->d_out, this->d_produced);
    return count;
}

} // namespace gr::wiforce
