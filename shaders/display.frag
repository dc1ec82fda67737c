// A finished picture, as a display is sent it.
#include "display.glsl"

uniform sampler2D picture;      // XYZ, row 0 below
uniform mat3 display_from_xyz;  // adaptation to the display's white, and exposure
uniform vec2 size;              // of what is drawn on, px

out vec4 signal;

void main()
{
    vec3 xyz = texture(picture, gl_FragCoord.xy / size).rgb;
    signal = vec4(shown(display_from_xyz * xyz), 1.0);
}
