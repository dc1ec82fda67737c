// A surface lit by an environment, in one triple of channels; three channels or six, the renderer
// is the same and runs once a triple. Whoever includes this says how much of the light from a
// sampled direction the gloss returns:
//     float gloss_weight(float n_l, float n_v, float n_h, float h_l);  brdf * n_l / pdf

#include "cube.glsl"
#include "sampling.glsl"
#include "ward.glsl"

const int MOST_LAMPS = 32;

uniform samplerCube radiance;    // from each direction, without the lamps, Gaussian mips;
                                 // linear, this triple's channels
uniform int lamps;
uniform vec3 lamp_direction[MOST_LAMPS];  // unit, towards the lamp
uniform vec3 lamp_flux[MOST_LAMPS];       // radiance times solid angle, this triple's channels
uniform samplerCube irradiance;  // over pi, facing each direction, same channels
uniform float face_size;         // texels along a face of radiance's level 0
uniform int samples;
uniform vec3 rho_d;              // diffuse reflectance, this triple's channels
uniform vec3 rho_s;              // specular reflectance, this triple's channels
uniform float roughness;         // alpha, standard deviation of slope
uniform mat3 xyz_from_triple;    // this triple's columns of the matrix to XYZ
uniform vec3 eye;                // world

in vec3 world_position;
in vec3 world_normal;
in vec3 unshadowed;              // shadowed over unshadowed irradiance, this triple's channels
out vec4 xyz;

// Roughness of a pixel, not of a point: with the spread of the normals the pixel sees, or a lamp in
// a tight curve would come and go between pixels. Tokuyoshi and Kaplanyan, "Improved Geometric
// Specular Antialiasing" (2019): a Gaussian pixel of variance 1 / 2 pi, at most .18 added.
float alpha_of_pixel(vec3 n)
{
    vec3 dx = dFdx(n), dy = dFdy(n);
    float variance = (dot(dx, dx) + dot(dy, dy)) / (2.0 * PI);
    return sqrt(roughness * roughness + min(2.0 * variance, 0.18));
}

void main()
{
    vec3 v = normalize(eye - world_position);
    vec3 n = normalize(gl_FrontFacing ? world_normal : -world_normal);
    float alpha = alpha_of_pixel(n);
    // An interpolated normal may turn from the viewer near the outline: bring it back to the edge.
    n = normalize(n + v * max(0.0, 1e-3 - dot(n, v)));
    mat3 world_from_local = frame(n, v);
    float n_v = dot(n, v);

    vec3 gloss = vec3(0.0);
    for (int i = 0; i < samples; ++i) {
        vec3 h_local = ward_half_vector(hammersley(i, samples), alpha);
        vec3 h = world_from_local * h_local;
        float h_l = dot(h, v);
        vec3 l = 2.0 * h_l * h - v;
        float n_l = dot(n, l);
        if (h_l > 0.0 && n_l > 0.0) {
            float pdf = ward_pdf(h_local.z, h_l, alpha);
            float level = sample_level(l, pdf, float(samples), face_size);
            gloss += textureLod(radiance, l, level).rgb * gloss_weight(n_l, n_v, h_local.z, h_l);
        }
    }
    gloss /= float(samples);
    for (int i = 0; i < lamps; ++i) {
        vec3 l = lamp_direction[i];
        vec3 h = normalize(l + v);
        float n_l = dot(n, l);
        if (n_l > 0.0) {
            float n_h = dot(n, h), h_l = dot(h, l);
            gloss += lamp_flux[i] * gloss_weight(n_l, n_v, n_h, h_l) * ward_pdf(n_h, h_l, alpha);
        }
    }
    vec3 diffuse = textureLod(irradiance, n, 0.0).rgb * unshadowed;
    xyz = vec4(xyz_from_triple * (rho_d * diffuse + rho_s * gloss), 1.0);
}
