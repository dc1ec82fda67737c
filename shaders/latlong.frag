// The environment unwrapped: 2:1, row 0 at +Y, -Z in the middle and +X to its right, as
// stages/layouts.py has it.
#include "channels.glsl"
#include "sampling.glsl"

uniform samplerCube radiance[TRIPLES];  // from each direction, linear
uniform float level;                    // mip level: 0 sharp
uniform mat3 xyz_from_triple[TRIPLES];  // each triple's columns of the matrix to XYZ
uniform vec4 place;                     // of the map in the picture: lower left corner, size; px
uniform float turn;                     // rad: what is in the middle lies so far from -Z towards +X

out vec4 xyz;

void main()
{
    vec2 at = (gl_FragCoord.xy - place.xy) / place.zw;
    if (at != clamp(at, 0.0, 1.0)) discard;
    float azimuth = 2.0 * PI * (at.x - 0.5) + turn, height = PI * (at.y - 0.5);
    vec3 d = vec3(cos(height) * sin(azimuth), sin(height), -cos(height) * cos(azimuth));
    xyz = vec4(to_xyz(xyz_from_triple, FETCH(radiance, d, level)), 1.0);
}
