/* SPDX-License-Identifier: GPL-3.0-or-later
 *
 * A B210 for UHD, without USB: the software N210 with names and gains of a B210. With
 * LD_PRELOAD, UHD finds it by type=b200 while SOFTWARE_N210 holds the address of a
 * software N210, whose streams, clocks and faults it has.
 */

#include <algorithm>
#include <cstdlib>
#include <dlfcn.h>
#include <memory>
#include <string>
#include <uhd/device.hpp>
#include <uhd/types/ranges.hpp>
#include <vector>

namespace {

struct Direction {
    std::string frontend;
    uhd::gain_range_t gains; // as UHD's driver of the AD9361 states them
};

const Direction directions[] = {
    { "/mboards/0/dboards/A/rx_frontends/0", { 0.0, 76.0, 1.0 } },
    { "/mboards/0/dboards/A/tx_frontends/0", { 0.0, 89.75, 0.25 } },
};

class EmulatedB210 : public uhd::device
{
public:
    explicit EmulatedB210(uhd::device::sptr n210) : d_n210(n210)
    {
        _type = USRP;
        _tree = n210->get_tree();
        name("/name", "B-Series Device");
        name("/mboards/0/name", "B210");
        for (const auto& gain : _tree->list("/mboards/0/rx_codecs/A/gains"))
            _tree->remove("/mboards/0/rx_codecs/A/gains/" + gain);
        for (const auto& direction : directions) {
            name(direction.frontend + "/name",
                 direction.frontend.find("/rx") != std::string::npos ? "FE-RX1"
                                                                     : "FE-TX1");
            set_gains(direction);
        }
    }

    uhd::rx_streamer::sptr get_rx_stream(const uhd::stream_args_t& args) override
    {
        return d_n210->get_rx_stream(args);
    }
    uhd::tx_streamer::sptr get_tx_stream(const uhd::stream_args_t& args) override
    {
        return d_n210->get_tx_stream(args);
    }
    bool recv_async_msg(uhd::async_metadata_t& metadata, double timeout) override
    {
        return d_n210->recv_async_msg(metadata, timeout);
    }

private:
    void name(const std::string& path, const std::string& value)
    {
        _tree->remove(path);
        _tree->create<std::string>(path).set(value);
    }

    // A third of the range gives the level that a third of the SBX's gives, and a dB is a
    // dB as far as the SBX's range goes.
    void set_gains(const Direction& direction)
    {
        const uhd::fs_path gains = uhd::fs_path(direction.frontend) / "gains";
        const uhd::fs_path sbx = gains / _tree->list(gains).at(0);
        const auto inner = _tree->access<uhd::gain_range_t>(sbx / "range").get();
        std::shared_ptr<uhd::property<double>> gain = _tree->pop<double>(sbx / "value");
        _tree->remove(sbx);
        const auto range = direction.gains;
        const double above = (range.stop() - inner.stop()) / 3;
        const auto set = [gain, inner, above](const double& value) {
            gain->set(std::clamp(value - above, inner.start(), inner.stop()));
        };
        _tree->create<uhd::gain_range_t>(gains / "PGA" / "range").set(range);
        _tree->create<double>(gains / "PGA" / "value")
            .set_coercer([range](const double& value) { return range.clip(value, true); })
            .add_coerced_subscriber(set)
            .set(range.start());
        d_gains.push_back(gain);
    }

    uhd::device::sptr d_n210;
    std::vector<std::shared_ptr<uhd::property<double>>> d_gains;
};

bool asks_for_it(const uhd::device_addr_t& hint)
{
    return std::getenv("SOFTWARE_N210") && hint.get("type", "") == "b200" &&
           !hint.has_key("addr");
}

template <typename Function>
Function next(const char* symbol)
{
    return reinterpret_cast<Function>(dlsym(RTLD_NEXT, symbol));
}

} // namespace

// A registered device could not make another one, since make() holds a lock.
namespace uhd {

device_addrs_t device::find(const device_addr_t& hint, device_filter_t filter)
{
    if (asks_for_it(hint))
        return { device_addr_t("type=b200,name=B210,product=B210,serial=31415926") };
    return next<decltype(&device::find)>(
        "_ZN3uhd6device4findERKNS_13device_addr_tENS0_15device_filter_tE")(hint, filter);
}

device::sptr device::make(const device_addr_t& hint, device_filter_t filter, size_t which)
{
    const auto made = next<decltype(&device::make)>(
        "_ZN3uhd6device4makeERKNS_13device_addr_tENS0_15device_filter_tEm");
    if (!asks_for_it(hint))
        return made(hint, filter, which);
    device_addr_t n210 = hint;
    for (const auto& key : { "name", "product", "serial" })
        if (n210.has_key(key))
            n210.pop(key);
    n210["type"] = "usrp2";
    n210["addr"] = std::getenv("SOFTWARE_N210");
    return std::make_shared<EmulatedB210>(made(n210, filter, which));
}

} // namespace uhd
