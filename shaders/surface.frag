// What the eye meets, second half: it is written down here and lit afterwards, each point of the
// picture once, however small the triangles are and however many lie behind one another.
#include "channels.glsl"
#include "octahedron.glsl"
#include "sampling.glsl"

uniform float thing;       // its number, from 1; 0 is the environment

in vec3 world_normal;
in vec3 world_tangent;
in vec2 image_place;
#if SHADED
in Channels lost;
in mat3 hidden;
#endif

layout(location = 0) out vec4 facing;  // normal on the octahedron; its variance; tangent's angle
layout(location = 1) out vec4 what;    // thing; uv; log2 of the step in uv to the next point
#if SHADED
// hidden_light, its triples in xyz; hidden_sky: one coefficient in the first w, the others below
layout(location = 2) out vec4 sky_a;
layout(location = 3) out vec4 sky_b;
layout(location = 4) out vec4 lost_1;
#if TRIPLES > 1
layout(location = 5) out vec4 lost_2;
#endif
#if TRIPLES > 2
layout(location = 6) out vec4 lost_3;
#endif
#endif

void main()
{
    vec3 n = normalize(gl_FrontFacing ? world_normal : -world_normal);
    // How much normals turn within a point of the picture: Tokuyoshi and Kaplanyan, "Improved
    // Geometric Specular Antialiasing" (2019), for a Gaussian point of variance 1 / 2 pi.
    vec3 dx = dFdx(n), dy = dFdy(n);
    float variance = (dot(dx, dx) + dot(dy, dy)) / (2.0 * PI);
    mat3 about = frame(n);
    // 4: there is no tangent; angles are at most pi
    float angle = dot(world_tangent, world_tangent) > 0.25
        ? atan(dot(world_tangent, about[1]), dot(world_tangent, about[0])) : 4.0;
    facing = vec4(octahedron_from_direction(n), variance, angle);
    float step_in_uv = max(length(dFdx(image_place)), length(dFdy(image_place)));
    what = vec4(thing, image_place, log2(max(step_in_uv, 1e-12)));
#if SHADED
    sky_a = vec4(hidden[0].yz, hidden[1].xy);
    sky_b = vec4(hidden[1].z, hidden[2]);
    lost_1 = vec4(TRIPLE(lost, 0), hidden[0].x);
#if TRIPLES > 1
    lost_2 = vec4(TRIPLE(lost, 1), 0.0);
#endif
#if TRIPLES > 2
    lost_3 = vec4(TRIPLE(lost, 2), 0.0);
#endif
#endif
}
