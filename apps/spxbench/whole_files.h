// What the benchmarks of whole files share: a folder of their own, an earlier run's figures, charts.
#pragma once

#include <map>
#include <string>
#include <string_view>

#include "../common/app.h"
#include "spectex/heatmap.h"

namespace spectex::bench {

/// A folder of its own for textures and outputs, removed at the end.
class ScratchFolder {
public:
    /// @param beside  the folder to make it in; empty: where temporary files belong.
    explicit ScratchFolder(const std::string& beside);
    ~ScratchFolder();
    ScratchFolder(const ScratchFolder&) = delete;
    ScratchFolder& operator=(const ScratchFolder&) = delete;
    const std::string& path() const { return path_; }
    Status status() const;

private:
    std::string path_, error_;
};

/// An earlier run's rows by what they measured; none without a path. @param what  grid, scaling. @error input.
Result<std::map<std::string, app::Json>> read_baseline(const std::string& path, std::string_view what);

/// How many times as fast as the earlier run; empty where it has no such row.
std::string against(const std::map<std::string, app::Json>& baseline, const std::string& key, const char* member, double now);

/// NAME.svg and NAME.png in the folder. @error output.
Status draw(const std::string& folder, const std::string& name, const Chart& chart);

}  // namespace spectex::bench
