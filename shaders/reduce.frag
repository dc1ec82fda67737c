// Shaded points to fewer pixels, under a tent two pixels wide: smoother outlines than a mean. The
// same as `_reduced` in stages/preview.py.
uniform sampler2D points;   // XYZ
uniform ivec2 corner;       // of the picture, the pixel that the first of these points belongs to
uniform ivec2 last;         // the last of them; beyond it and the first, the picture's edge goes on
uniform int supersampling;  // points along a pixel's side

out vec4 xyz;

void main()
{
    int s = supersampling;
    ivec2 first = (ivec2(gl_FragCoord.xy) - corner) * s;
    vec3 sum = vec3(0.0);
    float total = 0.0;
    for (int y = -s; y < 2 * s; ++y) {
        for (int x = -s; x < 2 * s; ++x) {
            vec2 away = abs(vec2(x, y) - 0.5 * float(s - 1)) / float(s);
            float weight = max(0.0, 1.0 - away.x) * max(0.0, 1.0 - away.y);
            sum += weight * texelFetch(points, clamp(first + ivec2(x, y), ivec2(0), last), 0).rgb;
            total += weight;
        }
    }
    xyz = vec4(sum / total, 1.0);
}
