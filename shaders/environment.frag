// The environment itself.
#include "channels.glsl"

uniform samplerCube radiance[TRIPLES];   // from each direction, linear
uniform float level;                     // mip level: 0 sharp
uniform mat3 xyz_from_triple[TRIPLES];   // each triple's columns of the matrix to XYZ

in vec3 world_direction;
out vec4 xyz;

void main()
{
    xyz = vec4(to_xyz(xyz_from_triple, FETCH(radiance, world_direction, level)), 1.0);
}
