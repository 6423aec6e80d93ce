#include "spectex/scene.h"
namespace spectex {
std::string_view scene_format_name(SceneFormat f){constexpr std::string_view n[]={"pbrt-v4","Mitsuba 3","MaterialX","glTF 2.0","OBJ"};return n[static_cast<int>(f)];}
}
