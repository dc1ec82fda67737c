const float PI = 3.14159265358979;

// Point i of n of the Hammersley set, in [0, 1)^2, of layer k of `layers`. All layers together part
// the first coordinate into n * layers equal steps, and turn the second by the golden ratio.
vec2 hammersley(int i, int n, int k, int layers)
{
    uint bits = uint(i);
    bits = (bits << 16u) | (bits >> 16u);
    bits = ((bits & 0x55555555u) << 1u) | ((bits & 0xAAAAAAAAu) >> 1u);
    bits = ((bits & 0x33333333u) << 2u) | ((bits & 0xCCCCCCCCu) >> 2u);
    bits = ((bits & 0x0F0F0F0Fu) << 4u) | ((bits & 0xF0F0F0F0u) >> 4u);
    bits = ((bits & 0x00FF00FFu) << 8u) | ((bits & 0xFF00FF00u) >> 8u);
    float inverse = float(bits >> 8u) / 16777216.0;
    return vec2((float(i) + (float(k) + 0.5) / float(layers)) / float(n),
                fract(inverse + float(k) * 0.618033989));
}

// Unit vectors across the unit vector n, and n: Duff and others, "Building an Orthonormal Basis,
// Revisited" (2017).
mat3 frame(vec3 n)
{
    float s = n.z < 0.0 ? -1.0 : 1.0;
    float a = -1.0 / (s + n.z);
    float b = n.x * n.y * a;
    return mat3(vec3(1.0 + s * n.x * n.x * a, s * b, -s * n.x),
                vec3(b, s + n.y * n.y * a, -n.y), n);
}

// The same, the first leaning toward v. Following the viewer, not the world, it turns smoothly over
// a surface.
mat3 frame_toward(vec3 n, vec3 v)
{
    vec3 t = v - n * dot(n, v);
    float length_t = length(t);
    if (length_t < 1e-4) return frame(n);
    t /= length_t;
    return mat3(t, cross(n, t), n);
}
