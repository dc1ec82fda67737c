// A scene from far away in one direction, for its depth.
uniform mat4 clip_from_world;

in vec3 position;  // world

void main()
{
    gl_Position = clip_from_world * vec4(position, 1.0);
}
