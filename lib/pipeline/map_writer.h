// The file of a map of differences.
#pragma once

#include <memory>
#include <span>
#include <string>

#include "spectex/compare.h"
#include "spectex/io.h"
#include "spectex/pipeline.h"

namespace spectex::pipeline {

/// A map of differences: one float channel, as any viewer shows it.
class MapWriter {
public:
    static Result<MapWriter> create(const std::string& path, const Geometry& geometry, Metric metric, const std::string& white,
                                    const JobOptions& job) {
        MapWriter map;
        if (path.empty()) return map;
        ExrPart part;
        part.channels = {{"Y", PixelType::float32}};
        part.attributes["spectex:metric"] = std::string(metric_name(metric));
        part.attributes["spectex:white"] = white;
        Geometry plain = geometry;
        auto writer = ExrWriter::create(path, plain, {std::move(part)}, {PixelType::float32, "zip", job.threads});
        if (!writer) return std::move(writer).error();
        map.writer_ = *std::move(writer);
        return map;
    }
    Status write_row(int y, std::span<const float> values) {
        if (!writer_) return {};
        const std::byte* plane = reinterpret_cast<const std::byte*>(values.data());
        return writer_->write_rows(y, 1, {&plane, 1});
    }
    Status commit() { return writer_ ? writer_->commit() : Status(); }

private:
    std::unique_ptr<ExrWriter> writer_;
};

}  // namespace spectex::pipeline
