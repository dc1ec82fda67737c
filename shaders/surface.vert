uniform mat4 clip_from_world;

in vec3 position;  // world
in vec3 normal;    // world, unit
in vec3 sky;       // shadowed over unshadowed irradiance, one triple of channels

out vec3 world_position;
out vec3 world_normal;
out vec3 unshadowed;

void main()
{
    world_position = position;
    world_normal = normal;
    unshadowed = sky;
    gl_Position = clip_from_world * vec4(position, 1.0);
}
