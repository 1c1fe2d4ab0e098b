// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernels/kernels.h"

#include <gnuradio/block_detail.h>
#include <gnuradio/buffer_reader.h>
#include <gnuradio/wiforce/ofdm_channel_estimator.h>
#include <gnuradio/wiforce/phase_group_doppler.h>
#include <gnuradio/wiforce/preamble_fold.h>
#include <gnuradio/wiforce/recording_source.h>

#include "tag_values.h"

#include <algorithm>
#include <utility>

using namespace gr::wiforce;

void bind_packets(py::module& m); // packets.cc

// Makes a block of a table of weights, whose columns are the snapshots of a group.
template <class Made, class... Rest>
static auto
with_table(Made (*make)(const std::vector<std::complex<double>>&, int, Rest...))
{
    return [make](const complex_array& weights, int group_length, Rest... rest) {
        if (group_length >= 1 && weights.ndim() == 2 && weights.shape(1) != group_length)
            throw std::invalid_argument(
                "phase_group_doppler: weights must have group_length = " +
                std::to_string(group_length) + " columns, got " +
                std::to_string(weights.shape(1)));
        return make(flat(weights), group_length, rest...);
    };
}

static void bind_preamble_fold(py::module& m)
{
    py::class_<preamble_fold, gr::block, gr::basic_block, std::shared_ptr<preamble_fold>>
        fold(m,
             "preamble_fold",
             R"(Averages the repeated part of each sounding frame.

Input: samples, fc32 or sc16 (scaled by 1/32768). Output: a vector of a symbol's samples
per frame; the tag `snapshot` holds its index on the frame grid, on the first one and
after every gap that an `rx_time` tag reports.)");
    const auto with_frames = [](const auto& define) {
        define("frame_length"_a,
               "first_averaged"_a = 64,
               "repetitions"_a = 4,
               "sample_rate"_a = 12.5e6,
               "frame_offset"_a = 0,
               "item_type"_a = "fc32",
               "symbol_length"_a = 64);
    };
    with_frames(
        [&](const auto&... of) { fold.def(py::init(&preamble_fold::make), of...); });
    with_frames([&](const auto&... of) {
        fold.def_static(
            "tones",
            with_table(&preamble_fold::tones),
            "weights"_a,
            "group_length"_a,
            of...,
            "Tones of phase groups: this block and phase_group_doppler in one.");
    });
    with_frames([&](const auto&... of) {
        fold.def_static("collected",
                        &preamble_fold::collected,
                        "group_length"_a,
                        of...,
                        "Snapshots of phase groups: this block and "
                        "phase_group_doppler.collected in one.");
    });
    fold.def("expect_carrier",
             &preamble_fold::expect_carrier,
             "frequency_hz"_a,
             "Expects a carrier in Hz, to 0.1 %; samples of another one are discarded.")
        .def("refused_rate",
             &preamble_fold::refused_rate,
             "Rate in Hz that a tag reports, for which samples are discarded; else 0.")
        .def("refused_carrier",
             &preamble_fold::refused_carrier,
             "Carrier in Hz that a tag reports, for which samples are discarded; else 0.")
        .def("snapshots", &preamble_fold::snapshots, "Frames folded so far.")
        .def("gaps", &preamble_fold::gaps, "Gaps that `rx_time` reported.")
        .def("samples_lost", &preamble_fold::samples_lost, "Samples lost in them.")
        .def("times_ignored",
             &preamble_fold::times_ignored,
             "Values of `rx_time` that were malformed or implausible, and ignored.")
        .def("frames_moved",
             &preamble_fold::frames_moved,
             "Times that frame timing slipped without a report by `rx_time`.")
        .def("samples_moved",
             &preamble_fold::samples_moved,
             "Samples that count as lost in these slips, known modulo the frame length.")
        .def(
            "mean_frame",
            [](const preamble_fold& fold) { return copy(fold.mean_frame()); },
            R"(Mean of the first 1000 frames, guards included; empty while they are not
complete, and where samples are missing among them.)");
}

static void bind_ofdm_channel_estimator(py::module& m)
{
    py::class_<ofdm_channel_estimator,
               gr::sync_block,
               gr::block,
               gr::basic_block,
               std::shared_ptr<ofdm_channel_estimator>>(
        m,
        "ofdm_channel_estimator",
        R"(Estimates the channel on each subcarrier: FFT, times factors.

Each row's samples are first multiplied by its row of `rotation`, if given. Input and
output: vectors of rows x len(factors) complex, bins in natural FFT order.)")
        .def(py::init([](const complex_array& factors,
                         int rows,
                         const complex_array& rotation) {
                 return ofdm_channel_estimator::make(flat(factors), rows, flat(rotation));
             }),
             "factors"_a,
             "rows"_a = 1,
             "rotation"_a = complex_array(0));
}

static void bind_phase_group_doppler(py::module& m)
{
    py::class_<phase_group_doppler,
               gr::block,
               gr::basic_block,
               std::shared_ptr<phase_group_doppler>>(
        m,
        "phase_group_doppler",
        R"(Doppler tones of each phase group: P[m, k] = sum_n weights[m, n] h[n, k].

Input: a vector of symbol_length complex per snapshot, its index in the tag `snapshot`.
Output: a vector of M x symbol_length per group with the tag `group`; an incomplete one
carries the tag `missing`, and its snapshots and mask go out on the port `incomplete`
before it.)")
        .def(py::init(with_table(&phase_group_doppler::make)),
             "weights"_a,
             "group_length"_a,
             "symbol_length"_a = 64)
        .def_static(
            "spectrum",
            &phase_group_doppler::spectrum,
            "group_length"_a,
            "symbol_length"_a = 64,
            "The Fourier transform over the group, scaled by 1/N_g; M = N_g rows in "
            "natural FFT order.")
        .def_static(
            "collected",
            &phase_group_doppler::collected,
            "group_length"_a,
            "symbol_length"_a = 64,
            R"(The snapshots of each group, N_g x symbol_length, absent ones as zeros. The
tag `mask` of an incomplete group says which are present, `disturbed` those that
interference hit.)")
        .def("rows", &phase_group_doppler::rows, "Rows per output item, M.")
        .def("groups", &phase_group_doppler::groups, "Groups emitted.")
        .def("incomplete_groups",
             &phase_group_doppler::incomplete_groups,
             "Groups emitted with snapshots missing.");
}

static void bind_recording_source(py::module& m)
{
    py::class_<recording_source,
               gr::sync_block,
               gr::block,
               gr::basic_block,
               std::shared_ptr<recording_source>>(
        m,
        "recording_source",
        R"(Reads the folded preambles of a recording.

Segments are tuples (file sample, index in the stream, length) of unbroken runs, and a
fourth number, 1, where the device was retuned before it. Output: a vector of a symbol's
samples per frame, as of preamble_fold.)")
        .def(py::init([](const std::string& path,
                         const std::string& datatype,
                         const std::vector<std::vector<std::uint64_t>>& segments,
                         int frame_length,
                         int first_averaged,
                         int repetitions,
                         std::uint64_t frame_offset,
                         std::uint64_t header_bytes,
                         int symbol_length) {
                 std::vector<recording_source::segment> runs;
                 std::vector<std::size_t> retuned;
                 for (const auto& of : segments) {
                     if (of.size() != 3 && of.size() != 4)
                         throw std::invalid_argument(
                             "recording: segments must have 3 or 4 numbers each, got " +
                             std::to_string(of.size()));
                     if (of.size() == 4 && of[3] != 0)
                         retuned.push_back(runs.size());
                     runs.push_back({ of[0], of[1], of[2] });
                 }
                 return recording_source::make(path,
                                               datatype,
                                               runs,
                                               frame_length,
                                               first_averaged,
                                               repetitions,
                                               frame_offset,
                                               header_bytes,
                                               symbol_length,
                                               retuned);
             }),
             "path"_a,
             "datatype"_a,
             "segments"_a,
             "frame_length"_a,
             "first_averaged"_a = 64,
             "repetitions"_a = 4,
             "frame_offset"_a = 0,
             "header_bytes"_a = 0,
             "symbol_length"_a = 64)
        .def("snapshots", &recording_source::snapshots, "Frames folded so far.")
        .def("frames_moved",
             &recording_source::frames_moved,
             "Times that frame timing slipped without a gap between segments.")
        .def("samples_missing",
             &recording_source::samples_missing,
             "Samples that the segments promise and the file does not hold.");
}

static py::object rx_time_or_none(const pmt::pmt_t& value)
{
    const auto time = rx_time_value(value);
    return time ? py::make_tuple(time->seconds, time->fraction) : py::object(py::none());
}

// GNU Radio's own bindings do not give a buffer's state to Python.
static bool input_has_ended(const gr::block& block)
{
    if (!block.detail())
        return false;
    const auto input = block.detail()->input(0);
    gr::thread::scoped_lock guard(*input->mutex());
    return input->done() && input->items_available() == 0;
}

// Marks in the tags of one group.
static py::array_t<bool> marks_of(const std::vector<std::uint8_t>& marks, int value)
{
    py::array_t<bool> result(marks.size());
    std::transform(marks.begin(),
                   marks.end(),
                   result.mutable_data(),
                   [value](std::uint8_t mark) { return mark == value; });
    return result;
}

// Items at the first input of a block, and what their tags say. The samples stay in the
// buffer: they are valid until the block consumes them.
static py::list
collected_groups(const gr::block& block, int count, py::ssize_t group_length)
{
    const auto input = block.detail()->input(0);
    const std::uint64_t first = input->nitems_read();
    const py::ssize_t length =
        input->get_sizeof_item() / (group_length * sizeof(gr_complex));
    std::vector<gr::tag_t> tags;
    input->get_tags_in_range(tags, first, first + count, block.unique_id());
    struct group {
        std::uint64_t index = 0, saturated = 0;
        bool numbered = false, retuned = false;
        py::object present = py::none(), undisturbed = py::none();
        std::vector<std::pair<std::uint64_t, std::uint64_t>> misplaced; // of each slip
    };
    std::vector<group> groups(count);
    for (const gr::tag_t& tag : tags) {
        group& own = groups.at(tag.offset - first);
        if (pmt::eq(tag.key, keys::group)) {
            own.index = pmt::to_uint64(tag.value);
            own.numbered = true;
        } else if (pmt::eq(tag.key, keys::saturated))
            own.saturated = pmt::to_uint64(tag.value);
        else if (pmt::eq(tag.key, keys::retuned))
            own.retuned = true;
        else if (pmt::eq(tag.key, keys::slipped)) {
            const auto frames = pmt::u64vector_elements(tag.value);
            for (std::size_t i = 0; i + 1 < frames.size(); i += 2)
                own.misplaced.emplace_back(frames[i], frames[i + 1]);
        } else if (pmt::eq(tag.key, keys::mask))
            own.present = marks_of(pmt::u8vector_elements(tag.value), 1);
        else if (pmt::eq(tag.key, keys::disturbed))
            own.undisturbed = marks_of(pmt::u8vector_elements(tag.value), 0);
    }
    const auto* item = static_cast<const gr_complex*>(input->read_pointer());
    py::list result;
    for (const group& own : groups) {
        if (!own.numbered)
            throw std::invalid_argument(
                "snapshots without a tag 'group': connect after a "
                "block that collects them");
        // An array of memory that something else owns has a base, of which nothing comes.
        py::array_t<gr_complex> folded({ group_length, length }, item, py::none());
        folded.attr("setflags")("write"_a = false);
        result.append(py::make_tuple(own.index,
                                     folded,
                                     own.present,
                                     own.undisturbed,
                                     own.saturated,
                                     own.retuned,
                                     own.misplaced));
        item += group_length * length;
    }
    return result;
}

// A flowgraph holds the C++ part of its blocks only. This pointer to it holds the Python
// part as well, which the C++ part calls and does not own.
static py::object kept_with(std::shared_ptr<gr::basic_block> block, py::object owner)
{
    namespace internal = py::detail;
    auto* const pointer = block.get();
    std::shared_ptr<gr::basic_block> kept(
        pointer,
        [block = std::move(block), owner = owner.release()](gr::basic_block*) mutable {
            // The thread that ends the interpreter, which then counts as not initialized,
            // still destroys what programs have left: a device must be closed.
            if (Py_IsInitialized() ||
                (PyGILState_GetThisThreadState() && PyGILState_Check())) {
                py::gil_scoped_acquire lock;
                owner.dec_ref();
            }
            block.reset();
        });
    // What a cast does, but for two things: it would find the gateway, which holds the
    // block already, and it would replace the pointer by that of shared_from_this().
    auto* const type = internal::get_type_info(typeid(gr::basic_block));
    auto result =
        py::reinterpret_steal<py::object>(internal::make_new_instance(type->type));
    auto* const instance = reinterpret_cast<internal::instance*>(result.ptr());
    instance->owned = true;
    auto value = instance->get_value_and_holder();
    value.value_ptr() = pointer;
    new (std::addressof(value.holder<std::shared_ptr<gr::basic_block>>()))
        std::shared_ptr<gr::basic_block>(std::move(kept));
    value.set_holder_constructed();
    return result;
}

// Keeps what Python knows of this thread until it is released: made anew for each call of
// a block, it takes longer than the call.
static void keep_thread_state(bool kept)
{
    thread_local bool is_kept = false;
    if (kept == std::exchange(is_kept, kept))
        return;
    py::gil_scoped_acquire lock;
    if (kept)
        lock.inc_ref();
    else
        lock.dec_ref();
}

PYBIND11_MODULE(wiforce_python, m)
{
    py::register_local_exception_translator(translate_refusal);
    // The base classes' Python types.
    py::module::import("gnuradio.gr");
    py::module::import("pmt");
    bind_preamble_fold(m);
    bind_ofdm_channel_estimator(m);
    bind_phase_group_doppler(m);
    bind_recording_source(m);
    bind_packets(m);
    m.def("rx_time_value",
          &rx_time_or_none,
          "value"_a,
          "(whole seconds, fraction) in the value of an `rx_time` tag, or None.");
    m.def("collected_groups",
          &collected_groups,
          "block"_a,
          "count"_a,
          "group_length"_a,
          R"(The groups of collected snapshots at the input of a block, as tuples: index,
folded (N, L) in the buffer, present (N,) or None for all, undisturbed (N,) or None for
all, snapshots at full scale, whether retuned, first frame and end before each slip that
may lie elsewhere.)");
    m.def("kept_with",
          &kept_with,
          "block"_a,
          "owner"_a,
          "A block for a flowgraph, which keeps a Python object as long as it keeps the "
          "block.");
    m.def("keep_thread_state",
          &keep_thread_state,
          "kept"_a,
          "Whether the calling thread's Python state outlives the call.");
    m.def("input_has_ended",
          &input_has_ended,
          "block"_a,
          py::call_guard<py::gil_scoped_release>(),
          "Whether the first input of a block has ended and all its items are consumed; "
          "false while no flowgraph runs.");
}
