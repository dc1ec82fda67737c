// GGX: facets as on an ellipsoid, with a long tail. Walter, Marschner, Li and Torrance, "Microfacet
// Models for Refraction through Rough Surfaces" (2007), with the height-correlated shadowing of
// E. Heitz, "Understanding the Masking-Shadowing Function in Microfacet-Based BRDFs" (2014).
// Vectors are local, z along the normal, x along the tangent; alpha is along x and y, in (0, 1].
#include "sampling.glsl"

// How much of a facet's surroundings hides it from d: Smith's Lambda. Heitz (2014), eq. 72.
float hiding(vec3 d, vec2 alpha)
{
    vec2 a = alpha * d.xy / d.z;
    return 0.5 * (sqrt(1.0 + dot(a, a)) - 1.0);
}

// A facet as v sees them. E. Heitz, "Sampling the GGX Distribution of Visible Normals" (2018).
vec3 sample_half_vector(vec2 u, vec3 v, vec2 alpha)
{
    vec3 toward = normalize(vec3(alpha * v.xy, v.z));
    float across = length(toward.xy);
    vec3 x = across > 1e-6 ? vec3(-toward.y, toward.x, 0.0) / across : vec3(1.0, 0.0, 0.0);
    vec3 y = cross(toward, x);
    float r = sqrt(u.x), phi = 2.0 * PI * u.y;
    vec2 disc = r * vec2(cos(phi), sin(phi));
    disc.y = mix(sqrt(max(1.0 - disc.x * disc.x, 0.0)), disc.y, 0.5 * (1.0 + toward.z));
    vec3 h = disc.x * x + disc.y * y + sqrt(max(1.0 - dot(disc, disc), 0.0)) * toward;
    return normalize(vec3(alpha * h.xy, max(h.z, 1e-6)));
}

// Density (1/sr) with which those facets send light directions l = reflect(-v, h).
float light_pdf(vec3 h, vec3 v, float h_l, vec2 alpha)
{
    vec3 s = vec3(h.xy / alpha, h.z);
    float d = dot(s, s);
    return 1.0 / (4.0 * PI * alpha.x * alpha.y * d * d * v.z * (1.0 + hiding(v, alpha)));
}

float gloss_weight(vec3 l, vec3 v, vec3 h, float h_l, vec2 alpha)
{
    float seen = 1.0 + hiding(v, alpha);
    return seen / (seen + hiding(l, alpha));
}

#include "shade.glsl"
