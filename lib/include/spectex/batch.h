// Texture libraries: a folder of thousands of mixed files to a folder of spectral or coefficient EXRs.
//
// The destination keeps a manifest (SQLite, in DST/.spxbatch), so that nothing is done twice: a file whose size and time of
// change are as they were costs a stat, a moved or repeated one is recognised by its content (XXH3-128) and its output
// copied, and changed settings redo only what they change. An output appears under its name only when complete, and the
// manifest notes it afterwards; a run that is killed at any moment is completed by the next, to the same bytes. Paths are
// bytes, relative to SRC or DST with '/' between.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "spectex/base.h"
#include "spectex/pipeline.h"
#include "spectex/texture_use.h"

namespace spectex {

/// One part of N of a library, for job arrays: the files whose content's hash is `index` modulo `count`, so that repeated
/// files fall to one shard.
struct Shard {
    int index = 0, count = 1;
};
/// "I/N" with 0 <= I <= N, N from 1 to 100000; N/N is 0/N, so that arrays may be numbered from 0 or from 1.
/// @error usage.
SPECTEX_API Result<Shard> parse_shard(std::string_view text);

enum class DataMaps { skip, copy };

enum class BatchStatus {
    converted,  ///< uplifted, or copied from the output of the same content
    skipped,    ///< up to date, or holding spectra already
    data,       ///< no colour: left alone, or copied as it is
    failed,
};
SPECTEX_API std::string_view batch_status_name(BatchStatus status);

/// What happened to one file, or would.
struct BatchFile {
    std::string input;     ///< SRC and the relative path
    std::string relative;  ///< below SRC
    std::string output;    ///< DST and the relative path; empty when there is none
    BatchStatus status = BatchStatus::skipped;
    std::string reason;
    std::string use;            ///< texture_use_name, or "spectral"
    int width = 0, height = 0;  ///< 0 when unknown
    std::string content_hash, output_hash;  ///< XXH3-128, 32 hexadecimal digits; empty when unknown
    std::uint64_t nonfinite = 0, out_of_gamut = 0;
    bool measured = false;      ///< the round trip's figures are known, from this run or an earlier
    std::uint64_t measured_pixels = 0, changed_codes = 0;
    double mean = 0, p99 = 0, max = 0;  ///< CIE76 of the round trip
    double seconds = 0;         ///< that the conversion took, when it was made
};

struct BatchOptions {
    JobOptions job;  ///< progress over the pixels of all files that are converted
    UpliftSettings settings;
    Layout layout = Layout::single;
    std::string compression;
    bool check_all = false;
    std::vector<std::string> include, exclude;  ///< fnmatch(3) patterns on the relative path or the name; exclude wins
    /// Only these files, and as colour unless a rule of treat_as says otherwise: the reflectances of a scene.
    std::optional<std::vector<std::string>> only;
    std::vector<TreatAs> treat_as;
    DataMaps data = DataMaps::skip;
    int jobs = 0;              ///< files at once, at most; 0: as many as threads
    std::uint64_t memory = 0;  ///< bytes that the files in work may take by estimate (a larger one runs alone); 0: half of RAM
    std::optional<Shard> shard;
    bool dry_run = false;      ///< decide and report, write nothing
    /// Called from one thread at a time as each file is settled.
    std::function<void(const BatchFile& file, std::size_t done, std::size_t total)> on_file;
};

struct BatchReport {
    std::vector<BatchFile> files;  ///< by path, of this shard
    std::size_t converted = 0, skipped = 0, data = 0, failed = 0;
    std::size_t copied = 0;        ///< of the converted: by content, without computing
    std::size_t other_shards = 0, excluded = 0, not_images = 0;
    std::uint64_t pixels = 0;      ///< computed
    std::string model;             ///< one line; empty when nothing had to be known of it
};

/// Converts a library. A file that fails is reported and passed over.
/// @error usage: SRC is no folder, DST is SRC or holds it, DST's parent is missing; output: DST is locked by another run, or
/// its manifest is unusable; what solve_model says.
SPECTEX_API Result<BatchReport> run_batch(const std::string& source, const std::string& destination, const BatchOptions& options);

/// What the report's page says beside the files.
struct BatchPageOptions {
    JobOptions job;           ///< threads; progress over the textures that are read for thumbnails
    UpliftSettings settings;  ///< of the run
    Illuminant light;         ///< that the outputs are shown under
    std::vector<std::pair<std::string, std::string>> facts;  ///< settings, for people
    std::size_t most_rows = 10000;      ///< of the table: failures first, then the largest errors
    std::size_t most_pictures = 1000;   ///< textures with thumbnails: those of the largest errors
    bool keep_thumbnails = true;        ///< in DST/.spxbatch, so that the next report reads only what has changed
};
struct BatchPageReport {
    std::size_t rows = 0, pictures = 0, from_cache = 0, without = 0;  ///< without: outputs that could not be shown
    std::uint64_t bytes = 0;
};
/// One HTML page that stands alone: totals, failures, settings, histograms of the errors, what was left alone and why, and a
/// table that sorts, with thumbnails of each texture before and after relighting and of its errors. Figures of files that
/// were up to date are the manifest's. Names are escaped, whatever they hold; the page asks for nothing from outside.
/// @error output; usage when the folder is missing.
SPECTEX_API Result<BatchPageReport> write_batch_page(const std::string& path, const std::string& source, const std::string& destination,
                                                     const BatchReport& report, const BatchPageOptions& options);

/// Rereads every output that the manifest knows and compares hashes: `skipped` are whole, `failed` are not and will be made
/// again by the next run.
SPECTEX_API Result<BatchReport> verify_batch(const std::string& destination);

struct PruneReport {
    struct Output {
        std::string path, reason;
        bool removed = false;
    };
    std::vector<Output> outputs;
};
/// Outputs whose source is gone or that have another name now. An output that somebody has changed is kept.
/// @param remove  false: only says what would be removed.
SPECTEX_API Result<PruneReport> prune_batch(const std::string& source, const std::string& destination, bool remove);

struct MergeReport {
    std::size_t shards = 0, files = 0;
    std::vector<int> missing;  ///< indices of shards that have left no manifest
};
/// Joins the shards' manifests into the one that a single run would have left, and removes them.
/// @error input: no shard has run, or shards of different counts.
SPECTEX_API Result<MergeReport> merge_batch(const std::string& destination);

}  // namespace spectex
