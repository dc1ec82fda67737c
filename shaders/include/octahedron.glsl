// Unit vectors as two numbers in [-1, 1]: the sphere on an octahedron, unfolded. Meyer and others,
// "On Floating-Point Normal Vectors" (2010).
vec2 octahedron_from_direction(vec3 d)
{
    vec2 p = d.xy / (abs(d.x) + abs(d.y) + abs(d.z));
    vec2 away = (1.0 - abs(p.yx)) * vec2(p.x < 0.0 ? -1.0 : 1.0, p.y < 0.0 ? -1.0 : 1.0);
    return d.z < 0.0 ? away : p;
}

vec3 direction_from_octahedron(vec2 p)
{
    vec3 d = vec3(p, 1.0 - abs(p.x) - abs(p.y));
    float below = max(-d.z, 0.0);
    d.xy -= vec2(d.x < 0.0 ? -below : below, d.y < 0.0 ? -below : below);
    return normalize(d);
}
