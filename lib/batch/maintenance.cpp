// What is done with a manifest besides converting: verify, prune, merge.
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <charconv>
#include <filesystem>
#include <set>

#include "batch/discover.h"
#include "batch/manifest.h"
#include "io/internal.h"

namespace spectex {
namespace {

using namespace batch;
namespace fs = std::filesystem;

/// The manifest of a destination that a run has left. @error input when there is none.
Status check_manifest(const std::string& destination) {
    if (stamp_of(manifest_path(destination, std::nullopt))) return {};
    std::error_code error;
    for (const auto& entry : fs::directory_iterator(manifest_folder(destination), error))
        if (entry.path().filename().string().starts_with("shard-"))
            return Error{ErrorKind::input, fmt::format("{}: holds shards that are not joined: expected `spxbatch merge` first", destination)};
    return Error{ErrorKind::input, fmt::format("{}: no manifest: expected a folder that spxbatch has written", destination)};
}

struct Opened {
    std::vector<Lock> locks;
    Manifest manifest;
};
Result<Opened> open_locked(const std::string& destination) {
    if (auto s = check_manifest(destination); !s) return s.error();
    auto locks = lock_destination(destination, std::nullopt);
    if (!locks) return std::move(locks).error();
    auto manifest = Manifest::open(manifest_path(destination, std::nullopt), true);
    if (!manifest) return manifest.error();
    return Opened{*std::move(locks), *std::move(manifest)};
}

/// "shard-I-of-N.sqlite"
std::optional<Shard> shard_of_name(std::string_view name) {
    constexpr std::string_view head = "shard-", middle = "-of-", tail = ".sqlite";
    const auto at = name.find(middle);
    if (!name.starts_with(head) || !name.ends_with(tail) || at == std::string_view::npos) return std::nullopt;
    const auto index = name.substr(head.size(), at - head.size());
    const auto count = name.substr(at + middle.size(), name.size() - tail.size() - at - middle.size());
    const auto shard = parse_shard(fmt::format("{}/{}", index, count));
    return shard ? std::optional(*shard) : std::nullopt;
}

}  // namespace

Result<BatchReport> verify_batch(const std::string& destination) {
    auto opened = open_locked(destination);
    if (!opened) return opened.error();
    const auto rows = opened->manifest.rows();
    if (!rows) return rows.error();
    BatchReport report;
    for (const auto& [path, row] : *rows) {
        if (row.output.empty()) continue;
        BatchFile file;
        file.relative = file.input = path;
        file.use = row.use;
        file.content_hash = row.content;
        file.output = destination + "/" + row.output;
        if (!stays_below(row.output)) {
            file.status = BatchStatus::failed;
            file.reason = fmt::format("{}: the manifest names an output outside the folder", file.output);
        } else if (const auto hash = hash_file(file.output); !hash) {
            file.status = BatchStatus::failed;
            file.reason = hash.error().message;
        } else {
            file.output_hash = *hash;
            const bool whole = *hash == row.output_hash;
            file.status = whole ? BatchStatus::skipped : BatchStatus::failed;
            file.reason = whole ? "as it was written" : fmt::format("{}: its bytes are not those that were written", file.output);
        }
        if (file.status == BatchStatus::failed) {
            Row damaged = row;
            damaged.status = "damaged";
            damaged.output_hash.clear();
            if (auto s = opened->manifest.put(damaged); !s) return s.error();
            ++report.failed;
        } else {
            ++report.skipped;
        }
        report.files.push_back(std::move(file));
    }
    if (auto s = opened->manifest.flush(); !s) return s.error();
    return report;
}

Result<PruneReport> prune_batch(const std::string& source, const std::string& destination, bool remove) {
    struct stat s {};
    if (::stat(source.c_str(), &s) != 0 || !S_ISDIR(s.st_mode))
        return Error{ErrorKind::usage, fmt::format("{}: expected a folder of textures", source)};
    auto opened = open_locked(destination);
    if (!opened) return opened.error();
    const auto rows = opened->manifest.rows();
    if (!rows) return rows.error();
    const auto orphans = opened->manifest.orphans();
    if (!orphans) return orphans.error();
    const auto found = discover(source, destination);
    // What cannot be seen is not gone.
    if (!found.errors.empty()) return found.errors.front();
    const std::set<std::string> present(found.images.begin(), found.images.end());
    std::set<std::string> claimed;
    for (const auto& [path, row] : *rows)
        if (present.contains(path)) claimed.insert(row.output);

    PruneReport report;
    const auto take = [&](const std::string& output, const std::string& hash, std::string reason) {
        const std::string path = destination + "/" + output;
        if (output.empty() || !stays_below(output) || claimed.contains(output) || !stamp_of(path)) return true;
        const auto now = hash_file(path);
        const bool ours = now && *now == hash;
        if (!ours) reason += "; kept, since somebody has changed it";
        const bool removed = ours && remove && ::unlink(path.c_str()) == 0;
        report.outputs.push_back({path, std::move(reason), removed});
        if (removed) {
            std::error_code ignored;
            for (fs::path folder = fs::path(output).parent_path(); !folder.empty(); folder = folder.parent_path())
                if (!fs::remove(destination / folder, ignored)) break;
        }
        return removed;
    };
    for (const auto& [path, row] : *rows) {
        if (present.contains(path)) continue;
        if (take(row.output, row.output_hash, fmt::format("its source {} is gone", path)) && remove)
            if (auto status = opened->manifest.erase(path); !status) return status.error();
    }
    for (const auto& [output, hash] : *orphans)
        if (take(output, hash, "its source has another output now") && remove)
            if (auto status = opened->manifest.erase_orphan(output); !status) return status.error();
    if (auto status = opened->manifest.flush(); !status) return status.error();
    return report;
}

Result<MergeReport> merge_batch(const std::string& destination) {
    std::vector<std::pair<Shard, std::string>> shards;
    std::error_code error;
    for (const auto& entry : fs::directory_iterator(manifest_folder(destination), error))
        if (const auto shard = shard_of_name(entry.path().filename().string())) shards.emplace_back(*shard, entry.path().string());
    if (shards.empty()) return Error{ErrorKind::input, fmt::format("{}: no shard has left a manifest here", destination)};
    std::sort(shards.begin(), shards.end(), [](const auto& a, const auto& b) { return a.first.index < b.first.index; });
    const int count = shards.front().first.count;
    for (const auto& [shard, path] : shards)
        if (shard.count != count)
            return Error{ErrorKind::input, fmt::format("{}: shards of {} and of {}: expected those of one run", destination, count, shard.count)};
    auto locks = lock_destination(destination, std::nullopt);
    if (!locks) return std::move(locks).error();
    auto manifest = Manifest::open(manifest_path(destination, std::nullopt), true);
    if (!manifest) return manifest.error();

    MergeReport report;
    report.shards = shards.size();
    std::set<int> seen;
    std::map<std::string, Row> rows;
    for (const auto& [shard, path] : shards) {
        seen.insert(shard.index);
        const auto part = Manifest::open(path, false);
        if (!part) return part.error();
        const auto part_rows = part->rows();
        if (!part_rows) return part_rows.error();
        for (const auto& [file, row] : *part_rows)
            // The others' rows are only there to save a shard the hashing.
            if (row.status != "other shard" && (row.content.empty() || shard_of(row.content, count) == shard.index))
                rows.insert_or_assign(file, row);
        const auto orphans = part->orphans();
        if (!orphans) return orphans.error();
        for (const auto& [output, hash] : *orphans)
            if (auto s = manifest->add_orphan(output, hash); !s) return s.error();
    }
    for (int i = 0; i < count; ++i)
        if (!seen.contains(i)) report.missing.push_back(i);
    for (const auto& [file, row] : rows)
        if (auto s = manifest->put(row); !s) return s.error();
    if (auto s = manifest->flush(); !s) return s.error();
    // Only when the whole knows it all.
    for (const auto& [shard, path] : shards) {
        ::unlink(path.c_str());
        ::unlink((path + ".lock").c_str());
    }
    report.files = rows.size();
    return report;
}

}  // namespace spectex
