#include <fmt/format.h>

#include <map>
#include <mutex>

#include "spectex/spectral.h"
#include "spectral/names.h"

namespace spectex {
namespace {

struct ObserverFile {
    const char* id;
    const char* title;
    const char* lut;
    std::vector<std::string> aliases;  // folded
};

const std::vector<ObserverFile>& observer_files() {
    static const std::vector<ObserverFile> files = {
        {"cie1931", "CIE 1931 2°", "cie/cie1931_2deg_360-830-1.csv", {"1931", "2", "2deg", "19312", "cie19312"}},
        {"cie1964", "CIE 1964 10°", "cie/cie1964_10deg_360-830-1.csv", {"1964", "10", "10deg", "196410", "cie196410"}},
        {"cie2006-2", "CIE 2006 2°", "cie/cie2006_2deg_390-830-1.csv",
         {"20062", "20152", "cie20152", "cie20062deg", "cie20152deg"}},
        {"cie2006-10", "CIE 2006 10°", "cie/cie2006_10deg_390-830-1.csv",
         {"200610", "201510", "cie201510", "cie200610deg", "cie201510deg"}},
    };
    return files;
}

Result<std::shared_ptr<const Observer>> load(const ObserverFile& file) {
    auto table = load_spectral_table(file.lut);
    if (!table) return std::move(table).error();
    const auto& nm = table->wavelengths_nm;
    for (std::size_t i = 0; i < nm.size(); ++i)
        if (nm[i] != nm[0] + static_cast<double>(i))
            return Error{ErrorKind::input, fmt::format("{}: expected one row per nanometre", file.lut)};
    if (table->columns.size() != 3)
        return Error{ErrorKind::input, fmt::format("{}: expected columns x_bar, y_bar, z_bar", file.lut)};
    auto observer = std::make_shared<Observer>();
    observer->id = file.id;
    observer->title = file.title;
    observer->start_nm = nm[0];
    observer->x_bar = std::move(table->columns[0]);
    observer->y_bar = std::move(table->columns[1]);
    observer->z_bar = std::move(table->columns[2]);
    return std::shared_ptr<const Observer>(std::move(observer));
}

}  // namespace

Result<std::shared_ptr<const Observer>> find_observer(std::string_view name) {
    const auto wanted = folded_name(name);
    for (const auto& file : observer_files()) {
        bool match = wanted == folded_name(file.id);
        for (const auto& alias : file.aliases) match = match || wanted == alias;
        if (!match) continue;
        // Every Colorimetry asks for one: a table is parsed once.
        static std::mutex mutex;
        static std::map<std::string, std::shared_ptr<const Observer>> loaded;
        const std::lock_guard lock(mutex);
        if (const auto known = loaded.find(file.id); known != loaded.end()) return known->second;
        auto observer = load(file);
        if (observer) loaded[file.id] = *observer;
        return observer;
    }
    return Error{ErrorKind::usage, fmt::format("observer '{}' is not known: expected cie1931, cie1964, cie2006-2 or cie2006-10",
                                               name)};
}

std::vector<std::string> observer_ids() {
    std::vector<std::string> ids;
    for (const auto& file : observer_files()) ids.emplace_back(file.id);
    return ids;
}

}  // namespace spectex
