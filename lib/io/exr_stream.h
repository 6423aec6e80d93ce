// Scan line EXR on a descriptor of our own, so that a full disk is an error and not a short file.
#pragma once

#include <OpenEXR/ImfFrameBuffer.h>
#include <OpenEXR/ImfHeader.h>
#include <OpenEXR/ImfIO.h>
#include <OpenEXR/ImfMultiPartOutputFile.h>
#include <OpenEXR/ImfOutputPart.h>

#include <memory>
#include <optional>
#include <vector>

#include "io/internal.h"

namespace spectex::io {

/// Buffered, seekable. The first failure is kept: OpenEXR swallows what its destructors' writes throw.
class DescriptorStream final : public Imf::OStream {
public:
    explicit DescriptorStream(const std::string& path);
    ~DescriptorStream() override;
    DescriptorStream(const DescriptorStream&) = delete;
    DescriptorStream& operator=(const DescriptorStream&) = delete;
    void write(const char c[], int n) override;
    std::uint64_t tellp() override { return position_ + buffer_.size(); }
    void seekp(std::uint64_t position) override;
    /// Flushes and closes; what went wrong first, or nothing.
    std::optional<std::string> close();

private:
    void put(const char* bytes, std::size_t size);
    void flush();
    [[noreturn]] void fail(int code);
    int fd_ = -1;
    std::uint64_t position_ = 0;  // of the buffer's first byte
    std::vector<char> buffer_;
    std::string error_;
};

/// Where a channel's samples are: element (0, first row) and the strides in bytes.
struct SampleLayout {
    const std::byte* base = nullptr;
    std::size_t x_stride = 0, y_stride = 0;
};

/// One EXR being written to a temporary file.
class ExrOutput {
public:
    static Result<std::unique_ptr<ExrOutput>> create(const std::string& path, const Geometry& geometry,
                                                     const std::vector<ExrPart>& parts, const WriteOptions& options);
    ~ExrOutput();
    /// @param layouts  one per channel over all parts.
    Status write(int y, int rows, const std::vector<SampleLayout>& layouts);
    Status replace_text(const std::string& attribute, const std::string& text);
    Status commit();
    const std::vector<ExrPart>& parts() const { return parts_; }
    int width() const { return geometry_.width; }

private:
    class ZipChunks;
    explicit ExrOutput(OutputFile file);
    OutputFile file_;
    Geometry geometry_;
    std::vector<ExrPart> parts_;
    std::vector<Imf::Header> headers_;
    std::unique_ptr<DescriptorStream> stream_;
    std::unique_ptr<Imf::MultiPartOutputFile> output_;
    std::vector<Imf::OutputPart> outputs_;
    std::unique_ptr<ZipChunks> zip_;  // in place of the two above, for the compression that is worth it
    int next_row_ = 0;
    std::size_t header_bytes_ = 0;  // of headers and offset tables, ahead of the pixels
    std::vector<std::pair<std::string, std::string>> replacements_;  // bytes of an attribute as they stand, as they shall
};

}  // namespace spectex::io
