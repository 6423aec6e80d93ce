#include "batch/discover.h"

#include <OpenImageIO/imageio.h>
#include <OpenImageIO/strutil.h>
#include <dirent.h>
#include <fmt/format.h>
#include <fnmatch.h>
#include <sys/stat.h>

#include <algorithm>
#include <map>
#include <set>
#include <unordered_set>

#include "io/internal.h"

namespace spectex::batch {
namespace {

using Inode = std::pair<dev_t, ino_t>;

class Walk {
public:
    Walk(std::string root, const std::string& barred) : root_(std::move(root)) {
        struct stat s {};
        if (!barred.empty() && ::stat(barred.c_str(), &s) == 0) visited_.insert({s.st_dev, s.st_ino});
    }

    Discovery run() {
        folder("");
        // Links last: a folder is known by its real path if it has one here.
        while (!links_.empty()) {
            const auto next = *links_.begin();
            links_.erase(links_.begin());
            folder(next);
        }
        std::sort(found_.images.begin(), found_.images.end());
        return std::move(found_);
    }

private:
    void folder(const std::string& start) {
        std::vector<std::string> pending{start};
        while (!pending.empty()) {
            const std::string relative = std::move(pending.back());
            pending.pop_back();
            const std::string path = relative.empty() ? root_ : root_ + "/" + relative;
            struct stat s {};
            if (::stat(path.c_str(), &s) == 0 && !visited_.insert({s.st_dev, s.st_ino}).second) continue;
            DIR* dir = ::opendir(path.c_str());
            if (!dir) {
                found_.errors.push_back(io::input_error(path, "cannot read the folder: " + io::errno_text(errno)));
                found_.error_paths.push_back(relative);
                continue;
            }
            while (const dirent* entry = ::readdir(dir)) {
                const std::string name = entry->d_name;
                if (name.front() == '.') continue;
                take(relative.empty() ? name : relative + "/" + name, entry->d_type, pending);
            }
            ::closedir(dir);
        }
    }

    void take(const std::string& relative, unsigned char type, std::vector<std::string>& pending) {
        const std::string path = root_ + "/" + relative;
        struct stat s {};
        bool link = type == DT_LNK;
        if (type == DT_UNKNOWN && ::lstat(path.c_str(), &s) == 0) {
            link = S_ISLNK(s.st_mode);
            type = S_ISDIR(s.st_mode) ? DT_DIR : S_ISREG(s.st_mode) ? DT_REG : DT_UNKNOWN;
        }
        if (link) {
            // A dangling link to an image is listed, so that it is reported rather than passed over.
            if (::stat(path.c_str(), &s) == 0)
                type = S_ISDIR(s.st_mode) ? DT_DIR : S_ISREG(s.st_mode) ? DT_REG : DT_UNKNOWN;
            else
                type = DT_REG;
        }
        if (type == DT_DIR) {
            if (link)
                links_.insert(relative);
            else
                pending.push_back(relative);
        } else if (type == DT_REG && has_image_suffix(relative)) {
            found_.images.push_back(relative);
        } else {
            ++found_.not_images;
        }
    }

    std::string root_;
    std::set<Inode> visited_;
    std::set<std::string> links_;
    Discovery found_;
};

std::size_t name_begin(const std::string& path) {
    const auto slash = path.find_last_of('/');
    return slash == std::string::npos ? 0 : slash + 1;
}

std::string without_suffix(const std::string& path) {
    const auto dot = path.find_last_of('.');
    return dot == std::string::npos || dot <= name_begin(path) ? path : path.substr(0, dot);
}

}  // namespace

Discovery discover(const std::string& root, const std::string& barred) { return Walk(root, barred).run(); }

std::vector<std::string> output_names(const std::vector<std::string>& paths) {
    std::map<std::string, std::vector<std::size_t>> by_stem;
    for (std::size_t i = 0; i < paths.size(); ++i) by_stem[without_suffix(paths[i])].push_back(i);
    std::vector<std::string> names(paths.size());
    for (const auto& [stem, members] : by_stem)
        for (const auto i : members) names[i] = (members.size() > 1 ? paths[i] : stem) + ".exr";
    // `a.png.exr` as a source would take the name that a.png has beside a.jpg: full names are unique, so this ends.
    for (bool changed = true; changed;) {
        changed = false;
        std::map<std::string, std::vector<std::size_t>> by_name;
        for (std::size_t i = 0; i < names.size(); ++i) by_name[names[i]].push_back(i);
        for (const auto& [name, members] : by_name) {
            if (members.size() < 2) continue;
            for (const auto i : members) {
                changed = changed || names[i] != paths[i] + ".exr";
                names[i] = paths[i] + ".exr";
            }
        }
    }
    return names;
}

bool matches(const std::string& pattern, const std::string& path) {
    return ::fnmatch(pattern.c_str(), path.c_str(), 0) == 0 || ::fnmatch(pattern.c_str(), path.c_str() + name_begin(path), 0) == 0;
}

bool has_image_suffix(const std::string& path) {
    static const std::unordered_set<std::string> suffixes = [] {
        std::unordered_set<std::string> all;
        // "openexr:exr,sxr,mxr;tiff:tif,tiff,..."
        for (const auto& format : OIIO::Strutil::splits(OIIO::get_string_attribute("extension_list"), ";")) {
            const auto colon = format.find(':');
            const std::string name = format.substr(0, colon);
            // Films, volumes and procedures are no textures.
            if (colon == std::string::npos || name == "ffmpeg" || name == "openvdb" || name == "null" || name == "term") continue;
            for (const auto& suffix : OIIO::Strutil::splits(format.substr(colon + 1), ",")) all.insert(fmt::format(".{}", io::lower(suffix)));
        }
        return all;
    }();
    return suffixes.contains(io::suffix_of(path));
}

bool stays_below(const std::string& path) {
    if (path.empty() || path.front() == '/') return false;
    for (std::size_t at = 0; at <= path.size();) {
        const auto slash = std::min(path.find('/', at), path.size());
        if (const auto part = path.substr(at, slash - at); part.empty() || part == "." || part == "..") return false;
        at = slash + 1;
    }
    return true;
}

}  // namespace spectex::batch
