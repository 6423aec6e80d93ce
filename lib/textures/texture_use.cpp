#include "spectex/texture_use.h"

#include <fnmatch.h>

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "textures/name_tokens.h"

namespace spectex {
namespace {

constexpr std::array uses{TextureUse::color,        TextureUse::emission,  TextureUse::normal, TextureUse::roughness,
                          TextureUse::metallic,     TextureUse::displacement, TextureUse::occlusion, TextureUse::mask,
                          TextureUse::id,           TextureUse::lut,       TextureUse::packed, TextureUse::specular,
                          TextureUse::environment,  TextureUse::data};
constexpr std::array<std::string_view, uses.size()> use_names{"color",        "emission",  "normal", "roughness", "metallic",
                                                              "displacement", "occlusion", "mask",   "id",        "lut",
                                                              "packed",       "specular",  "environment", "data"};
constexpr std::array<std::string_view, uses.size()> use_sentences{
    "colour", "emitted colour", "normals", "roughness or gloss", "metalness", "height or displacement", "occlusion", "a mask",
    "IDs of parts", "a look-up table", "packed scalars", "a specular level", "surroundings that shine", "data"};

std::size_t index_of(TextureUse use) { return static_cast<std::size_t>(use); }

// What a word says. Strong words mean one thing only; plain ones mean mostly that; hints mean something only at the end of a
// name, where the pixels don't contradict.
enum class Weight { hint, plain, strong };
struct Word {
    std::string_view text;
    TextureUse use;
    Weight weight;
};
using enum TextureUse;
constexpr std::array words{
    Word{"diff", color, Weight::strong}, Word{"diffuse", color, Weight::strong}, Word{"dif", color, Weight::plain},
    Word{"albedo", color, Weight::strong}, Word{"alb", color, Weight::plain}, Word{"basecolor", color, Weight::strong},
    Word{"basecolour", color, Weight::strong}, Word{"color", color, Weight::strong}, Word{"colour", color, Weight::strong},
    Word{"col", color, Weight::plain}, Word{"colormap", color, Weight::strong}, Word{"diffusemap", color, Weight::strong},
    Word{"kd", color, Weight::plain}, Word{"d", color, Weight::hint}, Word{"c", color, Weight::hint},
    Word{"bc", color, Weight::hint}, Word{"photo", color, Weight::plain},
    Word{"emissive", emission, Weight::strong}, Word{"emission", emission, Weight::strong}, Word{"emit", emission, Weight::plain},
    Word{"emis", emission, Weight::plain}, Word{"emi", emission, Weight::plain}, Word{"glow", emission, Weight::plain},
    Word{"selfillum", emission, Weight::strong}, Word{"incandescence", emission, Weight::strong},
    Word{"normal", normal, Weight::strong}, Word{"normals", normal, Weight::strong}, Word{"normalmap", normal, Weight::strong},
    Word{"nor", normal, Weight::strong}, Word{"nrm", normal, Weight::strong}, Word{"norm", normal, Weight::strong},
    Word{"nmap", normal, Weight::strong}, Word{"ddn", normal, Weight::strong}, Word{"nm", normal, Weight::plain},
    Word{"normalgl", normal, Weight::strong}, Word{"normaldx", normal, Weight::strong}, Word{"n", normal, Weight::hint},
    Word{"roughness", roughness, Weight::strong}, Word{"rough", roughness, Weight::plain}, Word{"rgh", roughness, Weight::strong},
    Word{"gloss", roughness, Weight::strong}, Word{"glossiness", roughness, Weight::strong},
    Word{"glossmap", roughness, Weight::strong}, Word{"glossy", roughness, Weight::plain}, Word{"smoothness", roughness, Weight::strong},
    Word{"r", roughness, Weight::hint}, Word{"g", roughness, Weight::hint},
    Word{"metallic", metallic, Weight::strong}, Word{"metalness", metallic, Weight::strong},
    Word{"metallness", metallic, Weight::strong}, Word{"metalic", metallic, Weight::strong}, Word{"met", metallic, Weight::plain},
    Word{"mtl", metallic, Weight::plain}, Word{"metal", metallic, Weight::hint}, Word{"m", metallic, Weight::hint},
    Word{"displacement", displacement, Weight::strong}, Word{"disp", displacement, Weight::strong},
    Word{"displace", displacement, Weight::strong}, Word{"dsp", displacement, Weight::plain},
    Word{"height", displacement, Weight::strong}, Word{"heightmap", displacement, Weight::strong},
    Word{"hgt", displacement, Weight::strong}, Word{"bump", displacement, Weight::strong},
    Word{"bumpmap", displacement, Weight::strong}, Word{"parallax", displacement, Weight::strong},
    Word{"elevation", displacement, Weight::strong}, Word{"elev", displacement, Weight::strong},
    Word{"depth", displacement, Weight::plain}, Word{"h", displacement, Weight::hint},
    Word{"ao", occlusion, Weight::strong}, Word{"occlusion", occlusion, Weight::strong}, Word{"occ", occlusion, Weight::plain},
    Word{"ambientocclusion", occlusion, Weight::strong}, Word{"cavity", occlusion, Weight::strong},
    Word{"curvature", occlusion, Weight::strong}, Word{"thickness", occlusion, Weight::strong},
    Word{"opacity", mask, Weight::strong}, Word{"alpha", mask, Weight::plain}, Word{"mask", mask, Weight::strong},
    Word{"masks", mask, Weight::strong}, Word{"tcmask", mask, Weight::strong},
    Word{"colormask", mask, Weight::strong}, Word{"colourmask", mask, Weight::strong}, Word{"cutout", mask, Weight::plain},
    Word{"transparency", mask, Weight::strong}, Word{"transparent", mask, Weight::hint}, Word{"translucency", mask, Weight::plain},
    Word{"splat", mask, Weight::plain}, Word{"splatmap", mask, Weight::strong}, Word{"blendmap", mask, Weight::strong},
    Word{"stencil", mask, Weight::plain}, Word{"weightmap", mask, Weight::strong}, Word{"transmission", mask, Weight::plain},
    Word{"idmap", id, Weight::strong}, Word{"matid", id, Weight::strong}, Word{"materialid", id, Weight::strong},
    Word{"objectid", id, Weight::strong}, Word{"id", id, Weight::plain}, Word{"segmentation", id, Weight::strong},
    Word{"cryptomatte", id, Weight::strong},
    Word{"lut", lut, Weight::strong}, Word{"clut", lut, Weight::strong}, Word{"brdflut", lut, Weight::strong},
    Word{"orm", packed, Weight::strong}, Word{"arm", packed, Weight::hint}, Word{"mra", packed, Weight::strong},
    Word{"rma", packed, Weight::strong}, Word{"mrao", packed, Weight::strong}, Word{"rmao", packed, Weight::strong},
    Word{"aorm", packed, Weight::strong}, Word{"ormh", packed, Weight::strong}, Word{"ord", packed, Weight::plain},
    Word{"metallicroughness", packed, Weight::strong}, Word{"metalrough", packed, Weight::strong},
    Word{"metalroughness", packed, Weight::strong}, Word{"roughnessmetal", packed, Weight::strong}, Word{"roughmetal", packed, Weight::strong},
    Word{"roughnessmetallic", packed, Weight::strong}, Word{"occlusionroughnessmetallic", packed, Weight::strong},
    Word{"maskmap", packed, Weight::strong}, Word{"pbrdata", packed, Weight::strong}, Word{"specularglossiness", packed, Weight::strong},
    Word{"specular", specular, Weight::strong}, Word{"spec", specular, Weight::strong}, Word{"specularity", specular, Weight::strong},
    Word{"specmap", specular, Weight::strong}, Word{"ks", specular, Weight::plain}, Word{"reflection", specular, Weight::plain},
    Word{"refl", specular, Weight::plain}, Word{"sm", specular, Weight::hint}, Word{"s", specular, Weight::hint},
    Word{"hdri", environment, Weight::strong}, Word{"envmap", environment, Weight::strong},
    Word{"irradiance", environment, Weight::strong}, Word{"radiance", environment, Weight::plain},
    Word{"lightprobe", environment, Weight::strong}, Word{"lightmap", data, Weight::strong},
    Word{"shadow", data, Weight::plain}, Word{"shadowmap", data, Weight::strong}, Word{"flowmap", data, Weight::strong}, Word{"velocity", data, Weight::plain},
    Word{"anisotropy", data, Weight::strong}, Word{"aniso", data, Weight::strong}, Word{"anisotropic", data, Weight::plain},
    Word{"ior", data, Weight::plain}, Word{"positionmap", data, Weight::strong}, Word{"uvmap", data, Weight::strong},
};

constexpr double prior = 1;  // a file of which nothing is known is taken for colour
constexpr double strong_score = 3, plain_score = 2, hint_score = 1.2;
constexpr double folder_share = 0.4, earlier_share = 0.3;

double score_of(Weight weight) {
    return weight == Weight::strong ? strong_score : weight == Weight::plain ? plain_score : hint_score;
}

bool is_scalar(TextureUse use) {
    return use == roughness || use == metallic || use == displacement || use == occlusion || use == mask || use == specular;
}

const Word* find_word(std::string_view text) {
    const auto at = std::find_if(words.begin(), words.end(), [&](const Word& w) { return w.text == text; });
    return at == words.end() ? nullptr : &*at;
}

/// A word, or the long word that it begins or ends with (`earthnormal`, `envmapblue`); short ones are parts of too many others,
/// but for a few, which then say less.
const Word* meaning_of(std::string_view text) {
    if (const Word* exact = find_word(text)) return exact;
    const Word* best = nullptr;
    for (const Word& w : words)
        if (w.weight == Weight::strong && w.text.size() >= 6 &&
            (text.ends_with(w.text) || (text.starts_with(w.text) && w.text.size() >= 6)) && (!best || w.text.size() > best->text.size()))
            best = &w;
    static constexpr std::array ends{Word{"spec", specular, Weight::hint}, Word{"gloss", roughness, Weight::plain}, Word{"shadow", data, Weight::plain}};
    for (const Word& end : ends)
        if (!best && text.size() > end.text.size() && text.ends_with(end.text)) return &end;
    return best;
}

struct Witness {
    TextureUse use;
    double score;
    std::string says;  ///< a clause: "its name says roughness"
};

/// What one name says: at most two words of it count.
struct Telling {
    const Word* word = nullptr;
    std::string text;
    std::size_t position = 0;
    bool last = false;      ///< nothing but numbers and resolutions follow
};

bool says_nothing(const std::string& word) {
    static constexpr std::array<std::string_view, 18> fillers{"k", "gl", "dx", "ogl", "opengl", "directx", "map", "tex", "texture",
                                                               "x", "px", "high", "low", "seamless", "tile", "var", "v", "lod"};
    return std::any_of(word.begin(), word.end(), [](char c) { return c >= '0' && c <= '9'; }) ||
           std::find(fillers.begin(), fillers.end(), word) != fillers.end();
}

std::vector<Telling> tellings(const std::vector<std::string>& name) {
    std::vector<Telling> found;
    for (std::size_t i = 0; i < name.size(); ++i) {
        std::size_t used = 1;
        const Word* word = nullptr;
        std::string text = name[i];
        // Compounds that separators or capitals have cut: base_color, ambient occlusion, metallicRoughness, mat_id.
        for (std::size_t n = std::min<std::size_t>(3, name.size() - i); n >= 2 && !word; --n) {
            std::string joined;
            for (std::size_t k = 0; k < n; ++k) joined += name[i + k];
            if (const Word* w = find_word(joined); w && w->weight == Weight::strong) word = w, used = n, text = joined;
        }
        if (!word) word = meaning_of(name[i]);
        if (!word) continue;
        bool last = true;
        for (std::size_t k = i + used; k < name.size(); ++k) last = last && says_nothing(name[k]);
        // The name as a whole is no suffix: a file called `metal.png` or `s.png` shows metal, or whatever.
        if (word->weight == Weight::hint && (!last || (i == 0 && word->text == name[i]))) continue;
        found.push_back({word, text, i, last});
        i += used - 1;
    }
    return found;
}

void hear_name(std::string_view path, std::vector<Witness>& witnesses) {
    const auto found = tellings(textures::name_words(textures::texture_stem(path)));
    if (found.empty()) return;
    for (std::size_t i = 0; i < found.size(); ++i) {
        const Telling& t = found[i];
        double score = score_of(t.word->weight);
        if (i + 1 < found.size()) score *= earlier_share;
        // A plain word in front of others is often an adjective or a thing: arm_pose, alpha_particle, col_de_turini.
        else if (!t.last) score *= t.word->weight == Weight::plain ? 0.4 : 0.7;
        // A plain word that is the whole name says what the picture shows: arm.png.
        else if (t.word->weight == Weight::plain && t.position == 0) score *= 0.6;
        witnesses.push_back({t.word->use, score, fmt::format("its name has \"{}\", which stands for {}", t.text,
                                                             use_sentences[index_of(t.word->use)])});
    }
    // Two scalars side by side at the end are packed together: occlusion_roughness, metal_rough.
    if (found.size() >= 2) {
        const Telling &a = found[found.size() - 2], &b = found.back();
        const bool scalars = is_scalar(a.word->use) && is_scalar(b.word->use) && a.word->use != b.word->use &&
                             a.word->use != mask && b.word->use != mask && a.position + 1 == b.position && b.last;
        if (scalars)
            witnesses.push_back({packed, strong_score + 1, fmt::format("its name has \"{}\" and \"{}\" side by side, which stand for "
                                                                       "packed scalars", a.text, b.text)});
    }
}

void hear_folders(std::string_view path, std::string_view root, std::vector<Witness>& witnesses) {
    if (!root.empty() && path.starts_with(root)) path.remove_prefix(root.size());
    const auto slash = path.rfind('/');
    if (slash == std::string_view::npos) return;
    path = path.substr(0, slash);
    const auto before = path.rfind('/');
    const std::string_view folder = before == std::string_view::npos ? path : path.substr(before + 1);
    const auto found = tellings(textures::name_words(folder));
    if (found.empty() || found.back().word->weight == Weight::hint) return;
    const Telling& t = found.back();
    witnesses.push_back({t.word->use, folder_share * score_of(t.word->weight),
                         fmt::format("its folder \"{}\" stands for {}", folder, use_sentences[index_of(t.word->use)])});
}

void hear_header(std::string_view path, const ImageHeader& header, std::vector<Witness>& witnesses) {
    const bool grey = header.is_grey();
    const bool floating = header.type == PixelType::half || header.type == PixelType::float32;
    if (!header.has_color()) {
        witnesses.push_back({data, 6, "it has no colour channels"});
        return;
    }
    std::string lowered(path);
    std::transform(lowered.begin(), lowered.end(), lowered.begin(), [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c + 32) : c; });
    if (header.format == "hdr" || lowered.ends_with(".hdr") || lowered.ends_with(".rgbe"))
        witnesses.push_back({environment, 2.5, "it is a Radiance picture, as surroundings come"});
    if (grey && floating) witnesses.push_back({data, 1.6, "it is a single channel of floats"});
    if (grey && header.alpha < 0 && header.type == PixelType::uint16)
        witnesses.push_back({displacement, 1.4, "it is a single channel of 16 bits, as heights are stored"});
    if (floating && header.geometry.width == 2 * header.geometry.height && header.geometry.width >= 512)
        witnesses.push_back({environment, 0.6, "it is a floating-point panorama"});
    const std::string& space = header.color_hints.declared;
    if (space == "Raw" || space == "raw" || space == "Non-Color" || space == "data")
        witnesses.push_back({data, 2, fmt::format("its header declares the colour space {}", space)});
    // Programs give profiles to whatever they save: they count only where the name has not said what it is.
    const bool named = std::any_of(witnesses.begin(), witnesses.end(), [](const Witness& w) { return !is_color(w.use) && w.score >= strong_score; });
    if (!header.color_hints.icc_profile.empty() && !grey && !named)
        witnesses.push_back({color, 0.5, "it bears an ICC profile"});
    for (const char* camera : {"Make", "Exif:Model", "Model", "Exif:FNumber", "ExposureTime"})
        if (header.metadata.contains(camera)) {
            witnesses.push_back({color, 1, "a camera took it"});
            break;
        }
}

/// Whether the pixels are those of tangent-space normals: unit length, and around (0.5, 0.5, 1).
bool looks_normal(const PixelStatistics& p) {
    return p.channels == 3 && p.pixels >= 16 && p.unit_length >= 0.8 && p.mean[2] >= 0.7 && std::abs(p.mean[0] - 0.5) < 0.12 &&
           std::abs(p.mean[1] - 0.5) < 0.12;
}

void hear_pixels(const PixelStatistics& p, bool named_color, std::vector<Witness>& witnesses) {
    if (p.pixels < 16) return;
    if (looks_normal(p)) {
        witnesses.push_back({normal, 5, fmt::format("{:.0f}% of its pixels decode to unit vectors around (0, 0, 1)", 100 * p.unit_length)});
        return;
    }
    if (p.lut) witnesses.push_back({lut, 3.5, "its pixels are the ramps of a three-dimensional table"});
    if (named_color) return;
    if (p.over_one > 0.02) witnesses.push_back({environment, 1.2, fmt::format("{:.1f}% of its pixels exceed 1", 100 * p.over_one)});
    if (p.negative > 0.02) witnesses.push_back({data, 1.6, fmt::format("{:.0f}% of its pixels are negative", 100 * p.negative)});
    if (p.grey >= 0.999 && p.binary >= 0.97 && !p.constant && p.transparent == 0)
        witnesses.push_back({mask, 1.2, fmt::format("{:.0f}% of its pixels are black or white", 100 * p.binary)});
    if (p.channels == 3 && p.pixels >= 4096 && p.saturated >= 0.8 && p.largest_colors >= 0.98 && p.distinct_colors >= 3 &&
        p.distinct_colors <= 64 && p.flat >= 0.97 && p.transparent == 0)
        witnesses.push_back({id, 1.3, fmt::format("it consists of {} flat saturated colours", p.distinct_colors)});
}

/// What pixels take away from a use that a name suggests.
double contradiction(TextureUse use, double score, const PixelStatistics& p, std::string& says) {
    if (p.pixels < 16) return 0;
    if (use == normal && !looks_normal(p)) {
        // Filtering shortens normals, and those in object space point anywhere: both average as normals do.
        const auto near = [&](std::size_t k, double value, double by) { return std::abs(p.mean[k] - value) <= by; };
        const bool short_ones = near(0, 0.5, 0.1) && near(1, 0.5, 0.1) && p.mean[2] >= 0.7;
        const bool anywhere = p.unit_length >= 0.5 && near(0, 0.5, 0.2) && near(1, 0.5, 0.2) && near(2, 0.5, 0.2);
        if ((short_ones || anywhere) && score > hint_score) return 0;
        // Parts of a model on black or white, which are no vectors.
        const double drawn = 1 - p.binary;
        const bool bluish = p.mean[2] >= 1.3 * std::max(p.mean[0], p.mean[1]);
        if (drawn >= 0.2 && p.unit_length >= 0.8 * drawn && (score > hint_score || bluish)) return 0;
        says = "its pixels are no unit vectors";
        return 2.4;
    }
    // A channel that is empty everywhere, as in hardly any picture: scalars are kept in the others.
    const auto empty = [&](std::size_t k) { return p.mean[k] <= 0.01 && p.deviation[k] <= 0.03; };
    if (is_scalar(use) && use != mask && score > hint_score && p.channels == 3 && p.grey < 0.7 && !p.constant && (empty(0) || empty(1) || empty(2))) return 0;
    if (is_scalar(use) && p.channels == 3 && p.grey < 0.7) {
        says = fmt::format("{:.0f}% of its pixels are coloured", 100 * (1 - p.grey));
        // Coloured specular maps are reflectances at normal incidence; masks may keep one weight in each channel.
        return use == mask ? 1.2 : use == specular ? 2.6 : 1.8;
    }
    return 0;
}

}  // namespace

std::string_view texture_use_name(TextureUse use) { return use_names[index_of(use)]; }

bool is_color(TextureUse use) { return use == TextureUse::color || use == TextureUse::emission; }

Result<TextureUse> parse_texture_use(std::string_view name) {
    if (name == "colour") return TextureUse::color;
    const auto at = std::find(use_names.begin(), use_names.end(), name);
    if (at == use_names.end())
        return Error{ErrorKind::usage, fmt::format("\"{}\" is no use of a texture: expected one of {}", name, fmt::join(use_names, ", "))};
    return uses[static_cast<std::size_t>(at - use_names.begin())];
}

Result<TreatAs> parse_treat_as(std::string_view text) {
    const auto equals = text.rfind('=');
    if (equals == std::string_view::npos || equals == 0)
        return Error{ErrorKind::usage, fmt::format("\"{}\" is no rule: expected PATTERN=USE, for example *_mask*=mask", text)};
    const auto use = parse_texture_use(text.substr(equals + 1));
    if (!use) return use.error();
    return TreatAs{std::string(text.substr(0, equals)), *use};
}

TextureVerdict judge_texture(std::string_view path, const ImageHeader* header, const PixelStatistics* pixels,
                             const TextureUseOptions& options) {
    const std::string whole(path);
    const auto slash = path.rfind('/');
    const std::string name(slash == std::string_view::npos ? path : path.substr(slash + 1));
    std::string below = whole;
    if (!options.root.empty() && below.starts_with(options.root)) {
        below.erase(0, options.root.size());
        below.erase(0, std::min(below.find_first_not_of('/'), below.size()));
    }
    for (auto rule = options.treat_as.rbegin(); rule != options.treat_as.rend(); ++rule)
        for (const std::string* candidate : std::initializer_list<const std::string*>{&whole, &below, &name})
            if (::fnmatch(rule->pattern.c_str(), candidate->c_str(), 0) == 0)
                return {rule->use, true, 1, fmt::format("{}: by the rule {}={}", use_sentences[index_of(rule->use)], rule->pattern,
                                                        texture_use_name(rule->use))};

    std::vector<Witness> witnesses{{color, prior, "nothing says otherwise"}};
    hear_name(path, witnesses);
    const bool named_color = std::any_of(witnesses.begin() + 1, witnesses.end(), [](const Witness& w) { return is_color(w.use) && w.score >= plain_score; });
    hear_folders(path, options.root, witnesses);
    if (header) hear_header(path, *header, witnesses);
    if (pixels) hear_pixels(*pixels, named_color, witnesses);

    std::array<double, uses.size()> scores{};
    for (const Witness& w : witnesses) scores[index_of(w.use)] += w.score;
    std::string contradicted;
    if (pixels)
        for (const TextureUse use : uses) {
            std::string says;
            double& score = scores[index_of(use)];
            if (score <= 0) continue;
            const double less = contradiction(use, score, *pixels, says);
            if (less > 0 && score > prior && score - less <= prior) contradicted = std::move(says);
            score = std::max(0.0, score - less);
        }

    // Ties go to colour, which is first: better a data map too many on a list to look at than a texture left out.
    const auto best = static_cast<std::size_t>(std::max_element(scores.begin(), scores.end()) - scores.begin());
    double second = 0;
    for (std::size_t i = 0; i < scores.size(); ++i)
        if (i != best) second = std::max(second, scores[i]);
    const Witness* loudest = nullptr;
    for (const Witness& w : witnesses)
        if (index_of(w.use) == best && (!loudest || w.score > loudest->score)) loudest = &w;
    TextureVerdict verdict;
    verdict.use = uses[best];
    verdict.confidence = scores[best] / (scores[best] + second);
    verdict.reason = fmt::format("{}: {}", use_sentences[best], loudest ? loudest->says : "nothing says otherwise");
    if (verdict.use == color && !contradicted.empty())
        verdict.reason = fmt::format("colour, whatever its name says: {}", contradicted);
    return verdict;
}

Result<TextureVerdict> classify_texture(const std::string& path, const TextureUseOptions& options) {
    if (auto ruled = judge_texture(path, nullptr, nullptr, options); ruled.by_option) return ruled;
    auto reader = ImageReader::open(path, options.threads);
    if (!reader) return reader.error();
    const ImageHeader& header = (*reader)->header();
    if (options.sample_rows <= 0 || !header.has_color()) return judge_texture(path, &header, nullptr, options);
    const auto pixels = sample_pixels(**reader, options.sample_rows);
    if (!pixels) return pixels.error();
    return judge_texture(path, &header, &*pixels, options);
}

}  // namespace spectex
