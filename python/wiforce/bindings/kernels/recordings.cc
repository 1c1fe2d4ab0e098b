// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernels.h"

#include <kernel/recording/readers.h>

using namespace gr::wiforce::kernel;

// File sample, index, length and, where it is stated, whether the device was retuned.
using segment_list = std::vector<std::vector<std::uint64_t>>;

// An array that takes over the memory of its values.
template <class T>
static py::array_t<T> owned(std::vector<T>&& values, std::vector<py::ssize_t> shape = {})
{
    if (shape.empty())
        shape.push_back(values.size());
    auto* const memory = new std::vector<T>(std::move(values));
    const py::capsule owner(memory,
                            [](void* m) { delete static_cast<std::vector<T>*>(m); });
    return py::array_t<T>(std::move(shape), memory->data(), owner);
}

static py::object as_flags(std::vector<std::uint8_t>&& values)
{
    return owned(std::move(values)).attr("view")("bool");
}

static std::unique_ptr<folded_reader> reader_of(std::unique_ptr<recorded_frames> frames)
{
    return std::make_unique<folded_reader>(std::move(frames));
}

static std::unique_ptr<tone_reader> reader_of(std::unique_ptr<recorded_frames> frames,
                                              const complex_array& weights,
                                              const complex_array& factors,
                                              const complex_array& rotation,
                                              const std::vector<int>& bins)
{
    return std::make_unique<tone_reader>(std::move(frames),
                                         flat(weights),
                                         columns_of(weights),
                                         flat(factors),
                                         flat(rotation),
                                         bins);
}

// A reader of a recording's frames, made with further settings of its own.
template <class... Settings>
static auto make_reader(const std::string& path,
                        const std::string& datatype,
                        const segment_list& segments,
                        int frame_length,
                        int first_averaged,
                        int repetitions,
                        std::uint64_t frame_offset,
                        int symbol_length,
                        const Settings&... settings)
{
    std::vector<recording::segment> runs;
    for (const auto& of : segments)
        runs.push_back({ of.at(0), of.at(1), of.at(2), of.size() > 3 && of[3] != 0 });
    auto frames = std::make_unique<recorded_frames>(
        path,
        datatype,
        runs,
        preamble_folder(frame_length, first_averaged, repetitions, symbol_length),
        frame_offset,
        0); // captures with a header are refused
    return reader_of(std::move(frames), settings...);
}

static py::dict read_folded(folded_reader& reader, std::size_t max_frames)
{
    folded_reader::batch frames;
    {
        py::gil_scoped_release others_may_run;
        frames = reader.read(max_frames);
    }
    const py::ssize_t count = frames.snapshot.size();
    const py::ssize_t length = reader.frames().symbol_length();
    std::vector<float> noise;
    noise.reserve(2 * count);
    for (const snapshot_noise& of : frames.noise)
        noise.insert(noise.end(), { of.smallest, of.largest });
    return py::dict("snapshot"_a = owned(std::move(frames.snapshot)),
                    "folded"_a = owned(std::move(frames.folded), { count, length }),
                    "noise"_a = owned(std::move(noise), { count, 2 }),
                    "saturated"_a = as_flags(std::move(frames.saturated)));
}

static py::tuple fold_frames(const array<std::int16_t>& frames,
                             int first_averaged,
                             int repetitions,
                             int symbol_length)
{
    const auto [count, length, parts] =
        sizes_of<3>(frames, "frames must have three dimensions");
    require_shape(frames, { count, length, 2 }, "frames must hold pairs of codes");
    const preamble_folder folder(length, first_averaged, repetitions, symbol_length);
    py::array_t<fc32> folded(shape{ count, symbol_length });
    py::array_t<float> noise(shape{ count, 2 });
    std::vector<int> saturated;
    folder.fold(reinterpret_cast<const sc16*>(frames.data()) + first_averaged,
                count,
                folded.mutable_data(),
                reinterpret_cast<snapshot_noise*>(noise.mutable_data()),
                saturated);
    return py::make_tuple(folded, noise, copy(saturated));
}

static py::dict
read_tones(tone_reader& reader, std::size_t max_groups, const py::object& on_incomplete)
{
    tone_reader::incomplete_handler handler;
    if (!on_incomplete.is_none())
        handler = [&](std::size_t row, const phase_group& group) {
            const py::gil_scoped_acquire python;
            py::array_t<fc32> folded({ group.present(), group.symbol_length() });
            group.copy_present_to(folded.mutable_data());
            auto mask = group.mask();
            on_incomplete(row, as_flags(std::move(mask)), folded);
        };
    tone_reader::batch groups;
    {
        py::gil_scoped_release others_may_run;
        groups = reader.read(max_groups, handler);
    }
    const py::ssize_t count = groups.index.size(), rows = reader.rows(),
                      bins = reader.bins().size();
    return py::dict("index"_a = owned(std::move(groups.index)),
                    "tones"_a = owned(std::move(groups.tones), { count, rows, bins }),
                    "missing"_a = owned(std::move(groups.missing)),
                    "rejected"_a = owned(std::move(groups.rejected)),
                    "saturated"_a = owned(std::move(groups.saturated)));
}

template <class Reader>
static void bind_counters(py::class_<Reader>& reader)
{
    reader
        .def(
            "snapshots",
            [](const Reader& r) { return r.frames().folded(); },
            "Frames folded so far.")
        .def(
            "samples_missing",
            [](const Reader& r) { return r.frames().samples_missing(); },
            "Samples that the segments promise and the file does not hold.")
        .def(
            "frames_moved",
            [](const Reader& r) { return r.frames().frames_moved(); },
            "Times that frame timing slipped without a gap between segments.")
        .def(
            "misplaced",
            [](const Reader& r) { return r.frames().misplaced(); },
            "Of each slip, the first frame that may lie elsewhere and the end.")
        .def(
            "retuned",
            [](const Reader& r) { return r.frames().retuned(); },
            "The first frame behind each retuning of the device.");
}

void bind_recordings(py::module& m)
{
    m.attr("COMPARED_FRAMES") = frame_watch::AVERAGED;
    m.attr("UNNOTICED_FRAMES") = frame_watch::UNNOTICED;
    m.def(
        "fold_frames",
        &fold_frames,
        "frames"_a,
        "first_averaged"_a,
        "repetitions"_a,
        "symbol_length"_a,
        R"(Folds frames (n, L, 2) of 16-bit codes, as preamble_fold does: vectors (n, symbol),
their noise (n, 2), smallest and largest, and which frames are saturated.)");
    py::class_<folded_reader> folded(
        m,
        "folded_reader",
        "Reads the folded preambles of a recording, as recording_source does.");
    folded
        .def(py::init(&make_reader<>),
             "path"_a,
             "datatype"_a,
             "segments"_a,
             "frame_length"_a,
             "first_averaged"_a = 64,
             "repetitions"_a = 4,
             "frame_offset"_a = 0,
             "symbol_length"_a = 64)
        .def("read",
             &read_folded,
             "max_frames"_a,
             R"(The next n <= max_frames snapshots: `snapshot`, `saturated` (n,), `folded`
(n, L), and `noise` (n, 2), smallest and largest. Releases the GIL.)");
    bind_counters(folded);

    py::class_<tone_reader> tones(
        m,
        "tone_reader",
        "weights: (M, N). factors: (L,). rotation: (M, L), or empty. bins: (K,).");
    tones
        .def(py::init(&make_reader<complex_array,
                                   complex_array,
                                   complex_array,
                                   std::vector<int>>),
             "path"_a,
             "datatype"_a,
             "segments"_a,
             "frame_length"_a,
             "first_averaged"_a,
             "repetitions"_a,
             "frame_offset"_a,
             "symbol_length"_a,
             "weights"_a,
             "factors"_a,
             "rotation"_a,
             "bins"_a)
        .def("read",
             &read_tones,
             "max_groups"_a,
             "on_incomplete"_a = py::none(),
             R"(The next G <= max_groups groups: `index`, `missing`, `rejected`,
`saturated` (G,) and `tones` (G, M, K). on_incomplete(row, mask (N,), folded (n, L)) is
called for each incomplete one. Releases the GIL.)");
    bind_counters(tones);
}
