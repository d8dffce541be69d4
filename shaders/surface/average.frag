// The mean of a pixel's SAMPLES, of a target whose first pixel is the viewport's.
uniform sampler2DMS u_samples;
uniform ivec2 u_corner;  // of the viewport

layout(location = 0) out vec4 out_mean;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy) - u_corner;
    vec4 sum = vec4(0);
    for (int s = 0; s < SAMPLES; s++)
        sum += texelFetch(u_samples, pixel, s);
    out_mean = sum / float(SAMPLES);
}
