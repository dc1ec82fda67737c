// How far from the light, 0 to 1.
out float depth;

void main()
{
    depth = gl_FragCoord.z;
}
