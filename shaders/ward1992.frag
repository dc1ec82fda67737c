// Ward's BRDF as he gave it in 1992: rho_s exp(-tan^2 / alpha^2) / (4 pi alpha^2 sqrt(n_l n_v)).
// It loses energy toward grazing angles.
#include "sampling.glsl"
#include "slopes.glsl"

float gloss_weight(vec3 l, vec3 v, vec3 h, float h_l, vec2 alpha)
{
    return h_l * h.z * h.z * h.z * sqrt(l.z / v.z);
}

#include "shade.glsl"
