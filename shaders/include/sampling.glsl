// Point i of n of the Hammersley set, in [0, 1)^2; half a step in, so that no point is at 0.
vec2 hammersley(int i, int n)
{
    uint bits = uint(i);
    bits = (bits << 16u) | (bits >> 16u);
    bits = ((bits & 0x55555555u) << 1u) | ((bits & 0xAAAAAAAAu) >> 1u);
    bits = ((bits & 0x33333333u) << 2u) | ((bits & 0xCCCCCCCCu) >> 2u);
    bits = ((bits & 0x0F0F0F0Fu) << 4u) | ((bits & 0xF0F0F0F0u) >> 4u);
    bits = ((bits & 0x00FF00FFu) << 8u) | ((bits & 0xFF00FF00u) >> 8u);
    return vec2((float(i) + 0.5) / float(n), float(bits >> 8u) / 16777216.0);
}

// Two unit vectors perpendicular to the unit vector n and to each other; the first leans toward v.
// Following the viewer, not the world, the frame turns smoothly over a surface.
mat3 frame(vec3 n, vec3 v)
{
    vec3 t = v - n * dot(n, v);
    float length_t = length(t);
    t = length_t > 1e-4 ? t / length_t : normalize(cross(n, n.yzx + vec3(0.3, 0.5, 0.7)));
    return mat3(t, cross(n, t), n);
}
