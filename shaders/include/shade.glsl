// A surface lit by an environment in any number of channels. Directions, levels and weights are the
// same for all of them. Whoever includes this says what the gloss is, in local vectors (z along
// the normal, x along the tangent) with alpha along x and y:
//     vec3 sample_half_vector(vec2 u, vec3 v, vec2 alpha);
//     float light_pdf(vec3 h, vec3 v, float h_l, vec2 alpha);                  1/sr
//     float gloss_weight(vec3 l, vec3 v, vec3 h, float h_l, vec2 alpha);       brdf n_l / pdf

#include "channels.glsl"
#include "cube.glsl"
#include "octahedron.glsl"

const int MOST_LAMPS = 32;
const int MATT_LAMPS = 8;
const int STEPS = 24;  // of specular reflectance by angle

uniform sampler2D facing, what;           // as surface.frag left them
#if SHADED
uniform sampler2D sky_a, sky_b, lost[TRIPLES];
uniform Channels surroundings;            // mean diffuse reflectance of what hides the sky
#endif

uniform float thing;                      // its number in `what`
uniform samplerCube radiance[TRIPLES];    // from each direction, without the lamps, Gaussian mips; linear
uniform int lamps;
uniform vec3 lamp_direction[MOST_LAMPS];  // unit, towards the lamp
uniform Channels lamp_flux[MOST_LAMPS];   // radiance times solid angle
uniform samplerCube irradiance[TRIPLES];  // over pi, facing each direction, without the lamps
uniform int matt_lamps;                   // the same lamps as few directions: a matt surface has no
uniform vec3 matt_direction[MATT_LAMPS];  // use for more, but for the line at which their light ends
uniform Channels matt_flux[MATT_LAMPS];
uniform float face_size;                  // texels along a face of radiance's level 0
uniform int samples;                      // a point
uniform int supersampling;                // points along a pixel's side; each has other samples
uniform vec2 roughness;                   // alpha, along the tangent and across
uniform mat3 xyz_from_triple[TRIPLES];    // each triple's columns of the matrix to XYZ
#if TEXTURED
uniform sampler2D image[TRIPLES];         // diffuse reflectance, mips, linear
#else
uniform Channels rho_d;                   // diffuse reflectance
#endif
#if ANGULAR
uniform Channels rho_s[STEPS];  // specular reflectance; cosine 0 to 1 on the facets, by its root
#else
uniform Channels rho_s;                   // specular reflectance
#endif

in vec3 world_direction;
out vec4 xyz;

// Specular reflectance at a cosine on the facets that mirror.
Channels mirrored(float h_l)
{
#if ANGULAR
    float x = sqrt(min(h_l, 1.0)) * float(STEPS - 1);
    int k = min(int(x), STEPS - 2);
    float f = x - float(k);
    return rho_s[k] * (1.0 - f) + rho_s[k + 1] * f;
#else
    return rho_s;
#endif
}

#if SHADED
// What share of a unit direction the things about hide, in [0, 1]: linear plus quadratic in the
// direction, coefficients x y z xx yy zz xy yz zx, as stages/shadows.py fits them to each vertex's
// horizon and all above it.
float share_hidden(mat3 c, vec3 d)
{
    return clamp(dot(c[0], d) + dot(c[1], d * d) + dot(c[2], d * d.yzx), 0.0, 1.0);
}
#endif

void main()
{
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 here = texelFetch(what, at, 0);
    if (here.x != thing) discard;
    vec4 turned = texelFetch(facing, at, 0);
    vec3 v = -normalize(world_direction);
    vec3 n = direction_from_octahedron(turned.xy);
    Channels light = FETCH(irradiance, n, 0.0);
    for (int i = 0; i < matt_lamps; ++i)
        light += matt_flux[i] * (max(dot(n, matt_direction[i]), 0.0) / PI);
#if SHADED
    vec4 a = texelFetch(sky_a, at, 0), b = texelFetch(sky_b, at, 0);
    vec4 first = texelFetch(lost[0], at, 0);
    mat3 hidden = mat3(vec3(first.w, a.xy), vec3(a.zw, b.x), b.yzw);
#if TRIPLES == 1
    light -= first.rgb;
#elif TRIPLES == 2
    light -= mat2x3(first.rgb, texelFetch(lost[1], at, 0).rgb);
#else
    light -= mat3(first.rgb, texelFetch(lost[1], at, 0).rgb, texelFetch(lost[2], at, 0).rgb);
#endif
    Channels instead = times(surroundings, light);  // radiance of what hides the sky, as lit as this
#endif

    // Roughness of a point of the picture, not of the surface, or a lamp in a tight curve would
    // come and go between points. At most .18 added, as Tokuyoshi and Kaplanyan advise.
    vec2 alpha = sqrt(roughness * roughness + min(2.0 * turned.z, 0.18));
    // An interpolated normal may turn from the viewer near the outline: bring it back to the edge.
    n = normalize(n + v * max(0.0, 1e-3 - dot(n, v)));
    mat3 world_from_local;
    if (turned.w > 3.5) {
        world_from_local = frame_toward(n, v);
    } else {
        mat3 about = frame(n);
        vec3 t = cos(turned.w) * about[0] + sin(turned.w) * about[1];
        world_from_local = mat3(t, cross(n, t), n);
    }
    vec3 v_local = v * world_from_local;

    Channels gloss = Channels(0.0);
    int layers = supersampling * supersampling;
    int layer = at.x % supersampling + supersampling * (at.y % supersampling);
    float all_samples = float(samples * layers);
    for (int i = 0; i < samples; ++i) {
        vec3 h = sample_half_vector(hammersley(i, samples, layer, layers), v_local, alpha);
        float h_l = dot(h, v_local);
        vec3 l = 2.0 * h_l * h - v_local;
        if (h_l > 0.0 && l.z > 0.0) {
            vec3 d = world_from_local * l;
            float level = sample_level(d, light_pdf(h, v_local, h_l, alpha), all_samples, face_size);
            float weight = gloss_weight(l, v_local, h, h_l, alpha);
            Channels arriving = FETCH(radiance, d, level);
#if SHADED
            arriving += (instead - arriving) * share_hidden(hidden, d);
#endif
#if ANGULAR
            arriving = times(mirrored(h_l), arriving);
#endif
            gloss += arriving * weight;
        }
    }
    gloss *= 1.0 / float(samples);
    for (int i = 0; i < lamps; ++i) {
        vec3 l = lamp_direction[i] * world_from_local;
        if (l.z > 0.0) {
            vec3 h = normalize(l + v_local);
            float h_l = dot(h, l);
            float weight = gloss_weight(l, v_local, h, h_l, alpha) * light_pdf(h, v_local, h_l, alpha);
#if SHADED
            weight *= 1.0 - share_hidden(hidden, lamp_direction[i]);
#endif
#if ANGULAR
            gloss += times(mirrored(h_l), lamp_flux[i]) * weight;
#else
            gloss += lamp_flux[i] * weight;
#endif
        }
    }
#if !ANGULAR
    gloss = times(rho_s, gloss);
#endif
#if TEXTURED
    float texels = float(max(textureSize(image[0], 0).x, textureSize(image[0], 0).y));
    float level = max(here.w + log2(texels), 0.0);
    Channels diffuse = times(FETCH(image, here.yz, level), light);
#else
    Channels diffuse = times(rho_d, light);
#endif
    xyz = vec4(to_xyz(xyz_from_triple, diffuse + gloss), 1.0);
}
