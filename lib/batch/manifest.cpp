#include "batch/manifest.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sqlite3.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>
#include <xxhash.h>

#include <chrono>
#include <cstdlib>
#include <utility>

#include "io/internal.h"

namespace spectex::batch {
namespace {

constexpr int schema_version = 1;
constexpr auto flush_interval = std::chrono::milliseconds(250);

std::string hex(const XXH128_hash_t& hash) { return fmt::format("{:016x}{:016x}", hash.high64, hash.low64); }

constexpr const char* columns =
    "path, size, mtime_ns, content, status, use, use_reason, use_by_option, classifier, input_type, width, height, settings, gamut, "
    "out_of_gamut, nonfinite, output, output_size, output_mtime_ns, output_hash, measured_pixels, changed_codes, mean, p99, max, "
    "seconds";
constexpr int column_count = 26;

}  // namespace

std::optional<FileStamp> stamp_of(const std::string& path) {
    struct stat s {};
    if (::stat(path.c_str(), &s) != 0 || !S_ISREG(s.st_mode)) return std::nullopt;
    return FileStamp{s.st_size, static_cast<std::int64_t>(s.st_mtim.tv_sec) * 1000000000 + s.st_mtim.tv_nsec};
}

Result<std::string> hash_file(const std::string& path) {
    const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
    if (fd < 0) return io::input_error(path, io::errno_text(errno));
    const std::unique_ptr<XXH3_state_t, XXH_errorcode (*)(XXH3_state_t*)> state(XXH3_createState(), XXH3_freeState);
    XXH3_128bits_reset(state.get());
    std::vector<std::byte> buffer(std::size_t{1} << 18);
    for (;;) {
        const ssize_t n = ::read(fd, buffer.data(), buffer.size());
        if (n < 0 && errno == EINTR) continue;
        if (n < 0) {
            const int code = errno;
            ::close(fd);
            return io::input_error(path, io::errno_text(code));
        }
        if (n == 0) break;
        XXH3_128bits_update(state.get(), buffer.data(), static_cast<std::size_t>(n));
    }
    ::close(fd);
    return hex(XXH3_128bits_digest(state.get()));
}

std::string hash_text(std::string_view text) { return hex(XXH3_128bits(text.data(), text.size())); }

int shard_of(const std::string& content_hash, int count) {
    const auto low = std::strtoull(content_hash.substr(std::min<std::size_t>(16, content_hash.size())).c_str(), nullptr, 16);
    return static_cast<int>(low % static_cast<unsigned long long>(count));
}

Lock::~Lock() {
    if (fd_ >= 0) ::close(fd_);
}
Lock::Lock(Lock&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
Lock& Lock::operator=(Lock&& other) noexcept {
    std::swap(fd_, other.fd_);
    return *this;
}

Result<Lock> Lock::take(const std::string& path, bool shared, const std::string& destination) {
    Lock lock;
    // A link here would create or lock a file of somebody else's choice.
    lock.fd_ = ::open(path.c_str(), O_RDWR | O_CREAT | O_NOFOLLOW | O_CLOEXEC, 0666);
    if (lock.fd_ < 0) return io::output_error(path, io::errno_text(errno));
    if (::flock(lock.fd_, (shared ? LOCK_SH : LOCK_EX) | LOCK_NB) != 0) {
        if (errno == EWOULDBLOCK)
            return io::output_error(destination, "another spxbatch is at work in this folder: wait for its end, or write elsewhere");
        return io::output_error(path, "cannot lock: " + io::errno_text(errno));
    }
    return lock;
}

std::string manifest_folder(const std::string& destination) { return destination + "/.spxbatch"; }

std::string manifest_path(const std::string& destination, const std::optional<Shard>& shard) {
    return manifest_folder(destination) +
           (shard ? fmt::format("/shard-{}-of-{}.sqlite", shard->index, shard->count) : std::string("/manifest.sqlite"));
}

Result<std::vector<Lock>> lock_destination(const std::string& destination, const std::optional<Shard>& shard) {
    std::vector<Lock> locks;
    auto whole = Lock::take(manifest_folder(destination) + "/lock", shard.has_value(), destination);
    if (!whole) return std::move(whole).error();
    locks.push_back(*std::move(whole));
    if (shard) {
        auto own = Lock::take(manifest_path(destination, shard) + ".lock", false, destination);
        if (!own) return std::move(own).error();
        locks.push_back(*std::move(own));
    }
    return locks;
}

struct Manifest::State {
    std::string path;
    sqlite3* db = nullptr;
    sqlite3_stmt* insert = nullptr;
    std::mutex mutex;
    bool in_transaction = false;
    std::chrono::steady_clock::time_point begun{};

    ~State() {
        if (insert) sqlite3_finalize(insert);
        if (db) {
            if (in_transaction) sqlite3_exec(db, "COMMIT", nullptr, nullptr, nullptr);
            sqlite3_close(db);
        }
    }
    Error failure(std::string_view doing) const {
        return io::output_error(path, fmt::format("{}: {}", doing, db ? sqlite3_errmsg(db) : "not open"));
    }
    Status run(const char* sql) {
        if (sqlite3_exec(db, sql, nullptr, nullptr, nullptr) != SQLITE_OK) return failure("cannot update the manifest");
        return {};
    }
    Status begin() {
        if (in_transaction) return {};
        if (auto s = run("BEGIN IMMEDIATE"); !s) return s;
        in_transaction = true;
        begun = std::chrono::steady_clock::now();
        return {};
    }
    Status commit() {
        if (!in_transaction) return {};
        in_transaction = false;
        return run("COMMIT");
    }
    Status commit_when_due() { return std::chrono::steady_clock::now() - begun >= flush_interval ? commit() : Status(); }
    /// One statement with texts bound as blobs, since a path is bytes.
    Status with_texts(const char* sql, std::initializer_list<std::string_view> texts) {
        if (!db) return {};
        const std::lock_guard lock(mutex);
        if (auto s = begin(); !s) return s;
        sqlite3_stmt* statement = nullptr;
        if (sqlite3_prepare_v2(db, sql, -1, &statement, nullptr) != SQLITE_OK) return failure("cannot update the manifest");
        int i = 0;
        for (const auto text : texts) sqlite3_bind_blob(statement, ++i, text.data(), static_cast<int>(text.size()), SQLITE_TRANSIENT);
        const int code = sqlite3_step(statement);
        sqlite3_finalize(statement);
        if (code != SQLITE_DONE) return failure("cannot update the manifest");
        return commit_when_due();
    }
};

Manifest::Manifest(std::unique_ptr<State> state) : state_(std::move(state)) {}
Manifest::~Manifest() = default;
Manifest::Manifest(Manifest&&) noexcept = default;

Result<Manifest> Manifest::open(const std::string& path, bool write) {
    auto state = std::make_unique<State>();
    state->path = path;
    if (!write && !stamp_of(path)) return Manifest(std::move(state));
    // A journal that an interrupted run left is rolled back by whoever opens next, which takes the right to write.
    const int flags = SQLITE_OPEN_READWRITE | SQLITE_OPEN_NOFOLLOW | (write ? SQLITE_OPEN_CREATE : 0);
    if (sqlite3_open_v2(path.c_str(), &state->db, flags, nullptr) != SQLITE_OK) return state->failure("cannot open the manifest");
    sqlite3_busy_timeout(state->db, 5000);
    // A destination may come from anywhere: its schema runs nothing, and no value is larger than any of ours.
    sqlite3_db_config(state->db, SQLITE_DBCONFIG_DEFENSIVE, 1, nullptr);
    sqlite3_db_config(state->db, SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0, nullptr);
    sqlite3_db_config(state->db, SQLITE_DBCONFIG_ENABLE_TRIGGER, 0, nullptr);
    sqlite3_db_config(state->db, SQLITE_DBCONFIG_ENABLE_VIEW, 0, nullptr);
    sqlite3_limit(state->db, SQLITE_LIMIT_LENGTH, 1 << 20);
    sqlite3_exec(state->db, "PRAGMA cell_size_check = ON", nullptr, nullptr, nullptr);
    int version = -1;
    const auto read_int = [](void* out, int, char** values, char**) {
        *static_cast<int*>(out) = std::atoi(values[0]);
        return 0;
    };
    if (sqlite3_exec(state->db, "PRAGMA user_version", read_int, &version, nullptr) != SQLITE_OK)
        return state->failure("not a manifest of spxbatch");
    if (version != 0 && version != schema_version)
        return io::output_error(path, fmt::format("a manifest of version {}: expected {}", version, schema_version));
    if (!write) return Manifest(std::move(state));
    // A rollback journal, not a write-ahead log: shards may share a network file system, which has no shared memory.
    if (auto s = state->run("PRAGMA journal_mode = TRUNCATE; PRAGMA synchronous = FULL"); !s) return s.error();
    if (version == 0) {
        if (auto s = state->run("BEGIN; CREATE TABLE IF NOT EXISTS files (path BLOB PRIMARY KEY, size INT, mtime_ns INT, content TEXT, "
                                "status TEXT, use TEXT, use_reason TEXT, use_by_option INT, classifier TEXT, input_type INT, "
                                "width INT, height INT, settings TEXT, gamut INT, out_of_gamut INT, nonfinite INT, output BLOB, "
                                "output_size INT, output_mtime_ns INT, output_hash TEXT, measured_pixels INT, changed_codes INT, "
                                "mean REAL, p99 REAL, max REAL, seconds REAL) WITHOUT ROWID; "
                                "CREATE TABLE IF NOT EXISTS orphans (output BLOB PRIMARY KEY, hash BLOB) WITHOUT ROWID; "
                                "PRAGMA user_version = 1; COMMIT");
            !s)
            return s.error();
    }
    std::string sql = fmt::format("INSERT OR REPLACE INTO files ({}) VALUES (?", columns);
    for (int i = 1; i < column_count; ++i) sql += ",?";
    if (sqlite3_prepare_v2(state->db, (sql + ")").c_str(), -1, &state->insert, nullptr) != SQLITE_OK)
        return state->failure("not a manifest of spxbatch");
    return Manifest(std::move(state));
}

Result<std::map<std::string, Row>> Manifest::rows() const {
    std::map<std::string, Row> rows;
    if (!state_->db) return rows;
    sqlite3_stmt* q = nullptr;
    if (sqlite3_prepare_v2(state_->db, fmt::format("SELECT {} FROM files", columns).c_str(), -1, &q, nullptr) != SQLITE_OK)
        return state_->failure("cannot read the manifest");
    int code;
    while ((code = sqlite3_step(q)) == SQLITE_ROW) {
        int at = 0;
        const auto text = [&] {
            const auto* data = static_cast<const char*>(sqlite3_column_blob(q, at));
            return std::string(data ? data : "", static_cast<std::size_t>(sqlite3_column_bytes(q, at++)));
        };
        const auto integer = [&] { return static_cast<std::int64_t>(sqlite3_column_int64(q, at++)); };
        const auto number = [&] { return static_cast<int>(sqlite3_column_int(q, at++)); };
        const auto real = [&] { return sqlite3_column_double(q, at++); };
        Row r;
        r.path = text();
        r.stamp.size = integer(), r.stamp.mtime_ns = integer();
        r.content = text(), r.status = text(), r.use = text(), r.use_reason = text();
        r.use_by_option = integer() != 0;
        r.classifier = text();
        r.input_type = number(), r.width = number(), r.height = number();
        r.settings = text();
        r.gamut = number();
        r.out_of_gamut = integer(), r.nonfinite = integer();
        r.output = text();
        r.output_stamp.size = integer(), r.output_stamp.mtime_ns = integer();
        r.output_hash = text();
        r.measured_pixels = integer(), r.changed_codes = integer();
        r.mean = real(), r.p99 = real(), r.max = real(), r.seconds = real();
        rows.emplace(r.path, std::move(r));
    }
    sqlite3_finalize(q);
    if (code != SQLITE_DONE) return state_->failure("cannot read the manifest");
    return rows;
}

Result<std::map<std::string, std::string>> Manifest::orphans() const {
    std::map<std::string, std::string> all;
    if (!state_->db) return all;
    sqlite3_stmt* q = nullptr;
    if (sqlite3_prepare_v2(state_->db, "SELECT output, hash FROM orphans", -1, &q, nullptr) != SQLITE_OK)
        return state_->failure("cannot read the manifest");
    int code;
    while ((code = sqlite3_step(q)) == SQLITE_ROW) {
        const auto text = [&](int at) {
            const auto* data = static_cast<const char*>(sqlite3_column_blob(q, at));
            return std::string(data ? data : "", static_cast<std::size_t>(sqlite3_column_bytes(q, at)));
        };
        all[text(0)] = text(1);
    }
    sqlite3_finalize(q);
    if (code != SQLITE_DONE) return state_->failure("cannot read the manifest");
    return all;
}

Status Manifest::put(const Row& r) {
    const std::lock_guard lock(state_->mutex);
    if (auto s = state_->begin(); !s) return s;
    sqlite3_stmt* q = state_->insert;
    int at = 0;
    const auto bytes = [&](const std::string& v) { sqlite3_bind_blob(q, ++at, v.data(), static_cast<int>(v.size()), SQLITE_TRANSIENT); };
    const auto text = [&](const std::string& v) { sqlite3_bind_text(q, ++at, v.data(), static_cast<int>(v.size()), SQLITE_TRANSIENT); };
    const auto integer = [&](std::int64_t v) { sqlite3_bind_int64(q, ++at, v); };
    const auto real = [&](double v) { sqlite3_bind_double(q, ++at, v); };
    bytes(r.path);
    integer(r.stamp.size), integer(r.stamp.mtime_ns);
    text(r.content), text(r.status), text(r.use), text(r.use_reason);
    integer(r.use_by_option);
    text(r.classifier);
    integer(r.input_type), integer(r.width), integer(r.height);
    text(r.settings);
    integer(r.gamut), integer(r.out_of_gamut), integer(r.nonfinite);
    bytes(r.output);
    integer(r.output_stamp.size), integer(r.output_stamp.mtime_ns);
    text(r.output_hash);
    integer(r.measured_pixels), integer(r.changed_codes);
    real(r.mean), real(r.p99), real(r.max), real(r.seconds);
    const int code = sqlite3_step(q);
    sqlite3_reset(q);
    if (code != SQLITE_DONE) return state_->failure("cannot update the manifest");
    return state_->commit_when_due();
}

Status Manifest::erase(const std::string& path) { return state_->with_texts("DELETE FROM files WHERE path = ?", {path}); }
Status Manifest::add_orphan(const std::string& output, const std::string& hash) {
    return state_->with_texts("INSERT OR REPLACE INTO orphans (output, hash) VALUES (?, ?)", {output, hash});
}
Status Manifest::erase_orphan(const std::string& output) {
    return state_->with_texts("DELETE FROM orphans WHERE output = ?", {output});
}

Status Manifest::flush() {
    const std::lock_guard lock(state_->mutex);
    return state_->db ? state_->commit() : Status();
}

}  // namespace spectex::batch
