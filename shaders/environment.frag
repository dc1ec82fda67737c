// The environment itself, in one triple of channels.
uniform samplerCube radiance;  // from each direction, linear, this triple's channels
uniform float level;           // mip level: 0 sharp
uniform mat3 xyz_from_triple;  // this triple's columns of the matrix to XYZ

in vec3 world_direction;
out vec4 xyz;

void main()
{
    xyz = vec4(xyz_from_triple * textureLod(radiance, world_direction, level).rgb, 1.0);
}
