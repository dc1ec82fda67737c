// What the eye meets, first half: a thing's vertices on their way to the picture.
#include "channels.glsl"

uniform mat4 clip_from_world;

in vec3 position;  // world
in vec3 normal;    // world, unit
in vec3 tangent;   // world, unit; 0 where the surface is the same all ways
in vec2 uv;        // place in an image, (0, 0) its lower left corner
#if SHADED
in Channels hidden_light;  // irradiance over pi that what is about takes away
in mat3 hidden_sky;        // what share of each direction it hides: see shade.glsl
#endif

out vec3 world_normal;
out vec3 world_tangent;
out vec2 image_place;
#if SHADED
out Channels lost;
out mat3 hidden;
#endif

void main()
{
    world_normal = normal;
    world_tangent = tangent;
    image_place = uv;
#if SHADED
    lost = hidden_light;
    hidden = hidden_sky;
#endif
    gl_Position = clip_from_world * vec4(position, 1.0);
}
