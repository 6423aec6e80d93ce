#include "batch/thumbnail_cache.h"

#include <sqlite3.h>

namespace spectex::batch {
namespace {

struct Statement {
    sqlite3_stmt* q = nullptr;
    Statement(sqlite3* db, const char* sql) { sqlite3_prepare_v2(db, sql, -1, &q, nullptr); }
    Statement(const Statement&) = delete;
    Statement& operator=(const Statement&) = delete;
    ~Statement() { sqlite3_finalize(q); }
    template <class Bytes>
    void bind(int at, const Bytes& bytes) {
        sqlite3_bind_blob(q, at, bytes.data(), static_cast<int>(bytes.size()), SQLITE_TRANSIENT);
    }
};

}  // namespace

ThumbnailCache::ThumbnailCache(const std::string& path) {
    if (path.empty()) return;
    const bool usable = sqlite3_open_v2(path.c_str(), &db_, SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE, nullptr) == SQLITE_OK &&
                        sqlite3_busy_timeout(db_, 2000) == SQLITE_OK &&
                        // What is lost with the power is made again.
                        sqlite3_exec(db_,
                                     "PRAGMA synchronous = OFF; CREATE TABLE IF NOT EXISTS thumbnails (path BLOB PRIMARY KEY, key BLOB, "
                                     "width INT, height INT, source BLOB, relit BLOB, errors BLOB); BEGIN",
                                     nullptr, nullptr, nullptr) == SQLITE_OK;
    if (usable) return;
    sqlite3_close(db_);
    db_ = nullptr;
}

ThumbnailCache::~ThumbnailCache() {
    if (!db_) return;
    sqlite3_exec(db_, "COMMIT", nullptr, nullptr, nullptr);
    sqlite3_close(db_);
}

std::optional<ThumbnailFiles> ThumbnailCache::find(const std::string& path, const std::string& key) {
    if (!db_) return std::nullopt;
    const std::lock_guard lock(mutex_);
    Statement s(db_, "SELECT width, height, source, relit, errors FROM thumbnails WHERE path = ? AND key = ?");
    if (!s.q) return std::nullopt;
    s.bind(1, path);
    s.bind(2, key);
    if (sqlite3_step(s.q) != SQLITE_ROW) return std::nullopt;
    ThumbnailFiles files;
    files.width = sqlite3_column_int(s.q, 0);
    files.height = sqlite3_column_int(s.q, 1);
    for (int i = 0; i < 3; ++i) {
        const auto* data = static_cast<const std::uint8_t*>(sqlite3_column_blob(s.q, 2 + i));
        if (!data) return std::nullopt;
        files.png[static_cast<std::size_t>(i)].assign(data, data + sqlite3_column_bytes(s.q, 2 + i));
    }
    return files;
}

void ThumbnailCache::keep(const std::string& path, const std::string& key, const ThumbnailFiles& files) {
    if (!db_) return;
    const std::lock_guard lock(mutex_);
    Statement s(db_, "INSERT OR REPLACE INTO thumbnails (path, key, width, height, source, relit, errors) VALUES (?, ?, ?, ?, ?, ?, ?)");
    if (!s.q) return;
    s.bind(1, path);
    s.bind(2, key);
    sqlite3_bind_int(s.q, 3, files.width);
    sqlite3_bind_int(s.q, 4, files.height);
    for (int i = 0; i < 3; ++i) s.bind(5 + i, files.png[static_cast<std::size_t>(i)]);
    sqlite3_step(s.q);
}

}  // namespace spectex::batch
