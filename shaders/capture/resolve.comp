// Box filter: the mean of SCALE × SCALE samples of each pixel. Reads premultiplied samples, writes premultiplied pixels.
layout(local_size_x = 8, local_size_y = 8) in;
layout(binding = 0) uniform sampler2D u_samples;
layout(rgba32f, binding = 0) writeonly uniform image2D out_pixels;
uniform ivec2 u_size;  // pixels

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (any(greaterThanEqual(pixel, u_size))) return;
    vec4 total = vec4(0);
    for (int y = 0; y < SCALE; ++y)
        for (int x = 0; x < SCALE; ++x) total += texelFetch(u_samples, pixel * SCALE + ivec2(x, y), 0);
    imageStore(out_pixels, pixel, total / float(SCALE * SCALE));
}
