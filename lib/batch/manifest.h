// What a destination remembers of its sources and outputs: one SQLite file, one row per source.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "spectex/batch.h"

struct sqlite3;

namespace spectex::batch {

/// What a stat says of a file.
struct FileStamp {
    std::int64_t size = -1, mtime_ns = 0;
    bool operator==(const FileStamp&) const = default;
};
/// Nothing when it is no regular file.
std::optional<FileStamp> stamp_of(const std::string& path);
/// XXH3-128 of a file's bytes as 32 hexadecimal digits. @error input.
Result<std::string> hash_file(const std::string& path);
std::string hash_text(std::string_view text);
/// Which of `count` shards a content belongs to.
int shard_of(const std::string& content_hash, int count);

struct Row {
    std::string path;  ///< relative
    FileStamp stamp;
    std::string content;
    std::string status;       ///< batch_status_name, "other shard" or "damaged"
    std::string use, use_reason;
    bool use_by_option = false;
    std::string classifier;   ///< version of the library that judged the use
    int input_type = 0;       ///< PixelType
    int width = 0, height = 0;
    std::string settings;     ///< hash of all that decides the output's bytes but for the gamut's policy
    int gamut = 0;
    std::int64_t out_of_gamut = 0, nonfinite = 0;
    std::string output;       ///< relative; empty when there is none
    FileStamp output_stamp;
    std::string output_hash;
    std::int64_t measured_pixels = 0, changed_codes = 0;
    double mean = 0, p99 = 0, max = 0;
    double seconds = 0;
};

/// Exclusive while it lives: flock(2) on a file of the destination, released by the kernel if the process dies.
class Lock {
public:
    Lock() = default;
    ~Lock();
    Lock(Lock&& other) noexcept;
    Lock& operator=(Lock&& other) noexcept;
    /// @error output, at once, when another process holds it.
    static Result<Lock> take(const std::string& path, bool shared, const std::string& destination);

private:
    int fd_ = -1;
};

std::string manifest_folder(const std::string& destination);
std::string manifest_path(const std::string& destination, const std::optional<Shard>& shard);
/// A whole run excludes everybody; a shard excludes whole runs, and its own twin.
Result<std::vector<Lock>> lock_destination(const std::string& destination, const std::optional<Shard>& shard);

/// Rows go to disk in groups, at least four times a second; a killed process loses no more than the last group, whose files
/// are then made again.
class Manifest {
public:
    ~Manifest();
    Manifest(Manifest&&) noexcept;
    /// @param write  false: an absent file is an empty manifest, and nothing is created.
    /// @error output: not a manifest, of another version, or unwritable.
    static Result<Manifest> open(const std::string& path, bool write);
    Result<std::map<std::string, Row>> rows() const;
    /// Outputs that no source has any more. Relative path to hash.
    Result<std::map<std::string, std::string>> orphans() const;
    Status put(const Row& row);
    Status erase(const std::string& path);
    Status add_orphan(const std::string& output, const std::string& hash);
    Status erase_orphan(const std::string& output);
    Status flush();

private:
    struct State;
    explicit Manifest(std::unique_ptr<State> state);
    std::unique_ptr<State> state_;
};

}  // namespace spectex::batch
