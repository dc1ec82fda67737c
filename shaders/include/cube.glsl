// Cube maps. Directions are world directions as stages/cube.py has them: texture(map, d) is the
// radiance that arrives from d. Faces lie in memory as OpenGL's table has them, so nothing is
// turned here.

// The mip level whose texels are as large as one of the samples drawn with density pdf (1/sr) in
// the unit direction d. Colbert and Krivanek, GPU Gems 3, chapter 20. Texels shrink towards the
// edges of a face: their solid angle is their area on the cube over the cube of its distance. The
// mips of stages/prefilter.py are Gaussian, a level blurrier than box mips: one level less.
float sample_level(vec3 d, float pdf, float samples, float face_size)
{
    vec3 a = abs(d);
    float major = max(a.x, max(a.y, a.z));  // 1 / distance to the cube of half edge 1
    float texel = 4.0 / (face_size * face_size) * major * major * major;  // sr
    return max(-0.5 * log2(samples * pdf * texel) - 1.0, 0.0);
}
