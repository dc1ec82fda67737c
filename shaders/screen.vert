// One triangle that covers the picture, at the far plane, with the world direction of each pixel.
uniform mat4 world_from_clip;  // of directions: the eye is at the origin

out vec3 world_direction;

void main()
{
    vec2 corner = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
    world_direction = (world_from_clip * vec4(corner, 1.0, 1.0)).xyz;
    gl_Position = vec4(corner, 1.0, 1.0);
}
