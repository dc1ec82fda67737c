// Channels: light or reflectance in all channels, a column of three for each triple of them.
// Whoever compiles this says `#define TRIPLES` 1, 2 or 3. Channels add and scale as GLSL has it.

#if TRIPLES == 1
#define Channels vec3
#define TRIPLE(c, k) (c)
#define FETCH(maps, d, level) textureLod(maps[0], d, level).rgb
#elif TRIPLES == 2
#define Channels mat2x3
#define TRIPLE(c, k) (c)[k]
#define FETCH(maps, d, level) \
    mat2x3(textureLod(maps[0], d, level).rgb, textureLod(maps[1], d, level).rgb)
#else
#define Channels mat3
#define TRIPLE(c, k) (c)[k]
#define FETCH(maps, d, level) \
    mat3(textureLod(maps[0], d, level).rgb, textureLod(maps[1], d, level).rgb, \
         textureLod(maps[2], d, level).rgb)
#endif
// FETCH(maps, d, level): from `sampler maps[TRIPLES]`. A macro, as GLSL ES 3.00 takes none but
// constants for the index of a sampler.

// Channel by channel.
Channels times(Channels a, Channels b)
{
#if TRIPLES == 1
    return a * b;
#else
    return matrixCompMult(a, b);
#endif
}

// XYZ of light: M Phi = M_1 Phi_1 + M_2 Phi_2 + ... over triples (Darling, Ferwerda, Berns and Chen,
// "Real-Time Multispectral Rendering with Complex Illumination" (2011), eq. 4).
vec3 to_xyz(mat3 xyz_from_triple[TRIPLES], Channels c)
{
    vec3 xyz = xyz_from_triple[0] * TRIPLE(c, 0);
#if TRIPLES > 1
    xyz += xyz_from_triple[1] * TRIPLE(c, 1);
#endif
#if TRIPLES > 2
    xyz += xyz_from_triple[2] * TRIPLE(c, 2);
#endif
    return xyz;
}
