// SPDX-License-Identifier: GPL-3.0-or-later
/*
 * A SoapySDR module for tests: a radio that receives what files contain, at the pace of
 * its sample rate. Its arguments say what it lacks and what it loses.
 *
 *   file, file2      samples of the antennas, complex 16-bit integers; file2 gives a
 *                    second receive channel
 *   time=0           neither a clock nor times of samples
 *   stale=1          a clock, but no times of samples
 *   full=0           half duplex
 *   tx=0             receives only
 *   drops=A:N;B:M    N samples before sample A of the file are lost, and so on, without
 *                    a report
 *   overflow=A:N     the same, and the driver reports an overflow
 *   throws=CALL:KIND an exception in this call: duplex, agc, rate, frequency, gain,
 *                    antenna, time; KIND is invalid or range, and std::runtime_error
 *                    without it
 *   nan=VALUE        what the driver states of it is no number: rate, frequency or gain
 *   bytes=1          the serial number is no UTF-8
 *   bits=12          of the converters: 16-bit integers are their codes, as those of
 *                    bladeRF and LimeSDR, and floats lie between -1 and 1
 *   sent=FILE        the largest code transmitted is written there
 */
#include <SoapySDR/Device.hpp>
#include <SoapySDR/Formats.hpp>
#include <SoapySDR/Registry.hpp>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <complex>
#include <cstdint>
#include <fstream>
#include <limits>
#include <map>
#include <sstream>
#include <stdexcept>
#include <thread>

namespace {

using sample = std::complex<std::int16_t>;
using clock_type = std::chrono::steady_clock;

constexpr std::size_t MTU = 1000;

std::vector<sample> samples_of(const std::string& path)
{
    std::ifstream file(path, std::ios::binary | std::ios::ate);
    if (!file)
        throw std::runtime_error("cannot read " + path);
    std::vector<sample> samples(file.tellg() / sizeof(sample));
    file.seekg(0);
    file.read(reinterpret_cast<char*>(samples.data()), samples.size() * sizeof(sample));
    return samples;
}

std::map<std::size_t, std::size_t> losses_of(const std::string& text)
{
    std::map<std::size_t, std::size_t> losses;
    std::istringstream parts(text);
    for (std::string part; std::getline(parts, part, ';');)
        losses[std::stoul(part)] = std::stoul(part.substr(part.find(':') + 1));
    return losses;
}

class player : public SoapySDR::Device
{
public:
    explicit player(const SoapySDR::Kwargs& args)
        : d_has_clock(value(args, "time", "1") == "1"),
          d_is_stale(value(args, "stale", "0") == "1"),
          d_is_full_duplex(value(args, "full", "1") == "1"),
          d_transmits(value(args, "tx", "1") == "1"),
          d_drops(losses_of(value(args, "drops", ""))),
          d_overflows(losses_of(value(args, "overflow", ""))),
          d_has_bytes(value(args, "bytes", "0") == "1"),
          d_throws(value(args, "throws", "")),
          d_nan(value(args, "nan", "")),
          d_scale(1 << (16 - std::stoi(value(args, "bits", "16")))),
          d_sent(value(args, "sent", ""))
    {
        for (const char* key : { "file", "file2" })
            if (args.count(key))
                d_received.push_back(samples_of(args.at(key)));
        if (d_received.empty())
            d_received.emplace_back();
    }

    std::string getDriverKey() const override { return "player"; }
    std::string getHardwareKey() const override { return "player of files"; }
    SoapySDR::Kwargs getHardwareInfo() const override
    {
        return { { "serial", d_has_bytes ? "\xff\xfe" : "7" } };
    }

    std::size_t getNumChannels(const int direction) const override
    {
        return direction == SOAPY_SDR_RX ? d_received.size() : d_transmits;
    }
    bool getFullDuplex(const int, const std::size_t) const override
    {
        fail("duplex");
        return d_is_full_duplex;
    }

    std::vector<std::string> getStreamFormats(const int, const std::size_t) const override
    {
        return { SOAPY_SDR_CS16, SOAPY_SDR_CF32 };
    }
    SoapySDR::Stream* setupStream(const int direction,
                                  const std::string& format,
                                  const std::vector<std::size_t>&,
                                  const SoapySDR::Kwargs&) override
    {
        d_has_floats[direction] = format == SOAPY_SDR_CF32;
        return reinterpret_cast<SoapySDR::Stream*>(&d_streams[direction]);
    }
    void closeStream(SoapySDR::Stream*) override {}
    std::size_t getStreamMTU(SoapySDR::Stream*) const override { return MTU; }
    int activateStream(SoapySDR::Stream* stream,
                       const int,
                       const long long,
                       const std::size_t) override
    {
        *reinterpret_cast<progress*>(stream) = { 0, clock_type::now() };
        return 0;
    }

    int readStream(SoapySDR::Stream* stream,
                   void* const* buffers,
                   const std::size_t count,
                   int& flags,
                   long long& time_ns,
                   const long timeout_us) override
    {
        auto& now = *reinterpret_cast<progress*>(stream);
        lose(now, d_drops);
        if (lose(now, d_overflows))
            return SOAPY_SDR_OVERFLOW;
        const std::size_t end = d_received[0].size();
        std::size_t taken = std::min({ count, MTU, end - std::min(end, now.samples) });
        for (const auto* losses : { &d_drops, &d_overflows })
            if (const auto next = losses->upper_bound(now.samples); next != losses->end())
                taken = std::min(taken, next->first - now.samples);
        if (taken == 0) {
            std::this_thread::sleep_for(std::chrono::microseconds(timeout_us));
            return SOAPY_SDR_TIMEOUT;
        }
        wait_for(now, taken);
        for (std::size_t channel = 0; channel < d_received.size(); channel++)
            convert(reinterpret_cast<const std::int16_t*>(d_received[channel].data() +
                                                          now.samples),
                    2 * taken,
                    buffers[channel]);
        if (d_has_clock && !d_is_stale) {
            flags |= SOAPY_SDR_HAS_TIME;
            time_ns = START_NS + std::llround(now.samples * 1e9 / d_rate);
        }
        now.samples += taken;
        return taken;
    }

    int writeStream(SoapySDR::Stream* stream,
                    const void* const* buffers,
                    const std::size_t count,
                    int&,
                    const long long,
                    const long) override
    {
        auto& now = *reinterpret_cast<progress*>(stream);
        const std::size_t taken = std::min(count, MTU);
        wait_for(now, taken);
        note_sent(buffers[0], 2 * taken);
        now.samples += taken;
        return taken;
    }

    std::vector<std::string> listAntennas(const int, const std::size_t) const override
    {
        return { "A", "B" };
    }
    void setAntenna(const int, const std::size_t, const std::string&) override
    {
        fail("antenna");
    }
    std::string getAntenna(const int, const std::size_t) const override { return "A"; }
    // One gain, which changes by itself until that is switched off.
    bool hasGainMode(const int, const std::size_t) const override { return true; }
    void setGainMode(const int, const std::size_t, const bool) override { fail("agc"); }
    void setGain(const int, const std::size_t, const double value) override
    {
        fail("gain");
        d_gain = value;
    }
    double getGain(const int, const std::size_t) const override
    {
        return stated("gain", d_gain);
    }
    SoapySDR::Range getGainRange(const int, const std::size_t) const override
    {
        return { stated("gain", 0), stated("gain", 60) };
    }
    void setFrequency(const int,
                      const std::size_t,
                      const double value,
                      const SoapySDR::Kwargs&) override
    {
        fail("frequency");
        d_frequency = value;
    }
    double getFrequency(const int, const std::size_t) const override
    {
        return stated("frequency", d_frequency);
    }
    SoapySDR::RangeList getFrequencyRange(const int, const std::size_t) const override
    {
        return { { 70e6, 950e6 } };
    }
    void setSampleRate(const int, const std::size_t, const double value) override
    {
        fail("rate");
        d_rate = value;
    }
    double getSampleRate(const int, const std::size_t) const override
    {
        return stated("rate", d_rate);
    }
    SoapySDR::RangeList getSampleRateRange(const int, const std::size_t) const override
    {
        return { { 1e6, 3e6 } };
    }
    bool hasHardwareTime(const std::string&) const override { return d_has_clock; }
    long long getHardwareTime(const std::string&) const override
    {
        fail("time");
        const auto since = clock_type::now() - d_streams[SOAPY_SDR_RX].began;
        return START_NS + std::chrono::nanoseconds(since).count();
    }

private:
    static constexpr long long START_NS = 5'000'000'000;

    struct progress {
        std::size_t samples = 0;
        clock_type::time_point began = clock_type::now();
    };

    static std::string
    value(const SoapySDR::Kwargs& args, const std::string& key, const char* otherwise)
    {
        return args.count(key) ? args.at(key) : otherwise;
    }

    static bool lose(progress& now, std::map<std::size_t, std::size_t>& losses)
    {
        const auto found = losses.find(now.samples);
        if (found == losses.end())
            return false;
        now.samples += found->second;
        losses.erase(found);
        return true;
    }

    void wait_for(const progress& now, std::size_t count) const
    {
        const std::chrono::duration<double> passed((now.samples + count) / d_rate);
        std::this_thread::sleep_until(
            now.began + std::chrono::duration_cast<clock_type::duration>(passed));
    }

    void fail(const std::string& call) const
    {
        if (d_throws == call)
            throw std::runtime_error(call + " failed");
        if (d_throws == call + ":invalid")
            throw std::invalid_argument(call + " failed");
        if (d_throws == call + ":range")
            throw std::out_of_range(call + " failed");
    }

    // Codes of the converter, or floats, from the 16 bits of a file.
    void convert(const std::int16_t* values, std::size_t count, void* buffer) const
    {
        for (std::size_t n = 0; n < count; n++) {
            const int code = std::floor(values[n] / d_scale);
            if (d_has_floats[SOAPY_SDR_RX])
                static_cast<float*>(buffer)[n] = code * d_scale / 32768;
            else
                static_cast<std::int16_t*>(buffer)[n] = code;
        }
    }

    void note_sent(const void* buffer, std::size_t count)
    {
        const int before = d_largest;
        for (std::size_t n = 0; n < count; n++)
            d_largest =
                std::max(d_largest,
                         d_has_floats[SOAPY_SDR_TX]
                             ? int(std::abs(static_cast<const float*>(buffer)[n]) *
                                   32768 / d_scale)
                             : std::abs(static_cast<const std::int16_t*>(buffer)[n]));
        if (d_largest > before && !d_sent.empty())
            std::ofstream(d_sent) << d_largest;
    }

    double stated(const char* what, double value) const
    {
        return d_nan == what ? std::numeric_limits<double>::quiet_NaN() : value;
    }

    const bool d_has_clock, d_is_stale, d_is_full_duplex, d_transmits;
    std::map<std::size_t, std::size_t> d_drops, d_overflows;
    const bool d_has_bytes;
    const std::string d_throws, d_nan;
    const float d_scale;
    const std::string d_sent;
    int d_largest = 0;
    bool d_has_floats[2] = {}; // of the streams
    std::vector<std::vector<sample>> d_received;
    progress d_streams[2]; // SOAPY_SDR_TX is 0, SOAPY_SDR_RX 1
    double d_gain = 0, d_frequency = 900e6, d_rate = 1e6;
};

SoapySDR::KwargsList find_player(const SoapySDR::Kwargs& args)
{
    const auto driver = args.find("driver");
    if (driver == args.end() || driver->second != "player")
        return {};
    SoapySDR::Kwargs found = args; // so that other arguments are another device
    found["label"] = "player of files";
    return { found };
}

SoapySDR::Device* make_player(const SoapySDR::Kwargs& args) { return new player(args); }

const SoapySDR::Registry
    registration("player", &find_player, &make_player, SOAPY_SDR_ABI_VERSION);

} // namespace
