// XYZ to what a display is sent: calibration/display.py's `show`, said in GLSL.

uniform mat3 rgb_from_xyz;   // of the display, linear, Y = 1 at its white
uniform float knee;          // where the tone curve leaves the identity; 1: it clips

// IEC 61966-2-1, for values in [0, 1].
vec3 encoded(vec3 linear)
{
    vec3 curved = 1.055 * pow(max(linear, vec3(1e-9)), vec3(1.0 / 2.4)) - 0.055;
    return mix(curved, 12.92 * linear, vec3(lessThanEqual(linear, vec3(0.0031308))));
}

// XYZ adapted to the display's white, Y = 1 there, to a signal in [0, 1]. Colours outside the gamut
// are mixed with the grey of their Y; the largest component goes through the shoulder and takes
// the others along.
vec3 shown(vec3 xyz)
{
    vec3 rgb = rgb_from_xyz * xyz;
    if (knee < 1.0) {
        float grey = max(xyz.y, 0.0);
        float least = min(rgb.r, min(rgb.g, rgb.b));
        if (least < 0.0) rgb = grey + grey / (grey - least) * (rgb - grey);
        float brightest = max(rgb.r, max(rgb.g, rgb.b));
        float room = 1.0 - knee;
        if (brightest > knee) rgb *= (knee + room * (1.0 - exp((knee - brightest) / room))) / brightest;
    }
    return encoded(clamp(rgb, 0.0, 1.0));
}
