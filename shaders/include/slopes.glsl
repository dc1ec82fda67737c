// Facets whose slopes are Gaussian, as Ward's BRDFs have them, sampled over their half vectors:
// B. Walter, "Notes on the Ward BRDF" (2005). Vectors are local, z along the normal, x along the
// tangent; alpha is along x and y, each in (0, 1].

vec3 sample_half_vector(vec2 u, vec3 v, vec2 alpha)
{
    float phi = 2.0 * PI * u.y;
    vec2 slope = alpha * sqrt(-log(1.0 - u.x)) * vec2(cos(phi), sin(phi));
    return normalize(vec3(slope, 1.0));
}

// Density (1/sr) with which those half vectors send light directions l = reflect(-v, h).
float light_pdf(vec3 h, vec3 v, float h_l, vec2 alpha)
{
    vec2 slope = h.xy / (h.z * alpha);
    return exp(-dot(slope, slope)) / (4.0 * PI * alpha.x * alpha.y * h_l * h.z * h.z * h.z);
}
