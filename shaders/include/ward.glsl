// Ward's isotropic BRDF, sampled over its half vectors: B. Walter, "Notes on the Ward BRDF" (2005).
// alpha: standard deviation of the surface's slope, (0, 1]. n_l, n_v, ...: cosines.

const float PI = 3.14159265358979;

// Half vector (z along the normal) for u in [0, 1)^2.
vec3 ward_half_vector(vec2 u, float alpha)
{
    float phi = 2.0 * PI * u.y;
    float tangent = alpha * sqrt(-log(1.0 - u.x));
    return normalize(vec3(tangent * cos(phi), tangent * sin(phi), 1.0));
}

// Density (1/sr) with which those half vectors send light directions l = reflect(-v, h).
float ward_pdf(float n_h, float h_l, float alpha)
{
    float cos2 = n_h * n_h;
    float tan2 = (1.0 - cos2) / cos2;
    return exp(-tan2 / (alpha * alpha)) / (4.0 * PI * alpha * alpha * h_l * n_h * cos2);
}
