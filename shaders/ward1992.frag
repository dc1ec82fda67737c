// Ward's BRDF as he gave it in 1992: rho_s exp(-tan^2 / alpha^2) / (4 pi alpha^2 sqrt(n_l n_v)).
// It loses energy toward grazing angles.

float gloss_weight(float n_l, float n_v, float n_h, float h_l)
{
    return h_l * n_h * n_h * n_h * sqrt(n_l / n_v);
}

#include "surface.glsl"
