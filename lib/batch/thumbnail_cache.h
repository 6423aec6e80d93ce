// Thumbnails that an earlier report made, beside the manifest, so that a report of what is up to date reads no texture.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

struct sqlite3;

namespace spectex::batch {

/// PNG files of a texture: source, relit, errors.
struct ThumbnailFiles {
    std::array<std::vector<std::uint8_t>, 3> png;
    int width = 0, height = 0;
};

/// One entry for each path; a cache that cannot be used is empty and forgets, which costs only time. Thread-safe.
class ThumbnailCache {
public:
    /// @param path  empty: nothing is kept.
    explicit ThumbnailCache(const std::string& path);
    ~ThumbnailCache();
    /// @param key  of all that the pictures depend on.
    std::optional<ThumbnailFiles> find(const std::string& path, const std::string& key);
    void keep(const std::string& path, const std::string& key, const ThumbnailFiles& files);

private:
    std::mutex mutex_;
    sqlite3* db_ = nullptr;
};

}  // namespace spectex::batch
