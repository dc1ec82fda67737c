// Cube maps. Directions are world directions as stages/cube.py has them: texture(map, d) is the
// radiance that arrives from d. Faces lie in memory as OpenGL's table has them, so nothing is
// turned here.

// Solid angle in sr of the texel of a cube of face_size^2 texels that the unit direction d meets:
// its area on the cube over the cube of its distance.
float texel_solid_angle(vec3 d, float face_size)
{
    vec3 a = abs(d);
    float major = max(a.x, max(a.y, a.z));  // 1 / distance to the cube of half edge 1
    return 4.0 / (face_size * face_size) * major * major * major;
}

// The mip level whose texels are as large as one of the samples drawn with density pdf (1/sr) in
// the unit direction d. Colbert and Krivanek, GPU Gems 3, chapter 20. The mips of
// stages/prefilter.py are Gaussian, about a level blurrier than box mips: half a level less.
float sample_level(vec3 d, float pdf, float samples, float face_size)
{
    float ratio = 1.0 / (samples * pdf * texel_solid_angle(d, face_size));
    return max(0.5 * log2(ratio) - 0.5, 0.0);
}
