// Step II, first pass: march every pixel's ray. Reads the volume; writes t and steps per pixel, and the lists of what is
// left to do. PARTS 0: all pixels, and rays that meet a part box go to a list. PARTS 1: the rays of that list.
layout(local_size_x = 64) in;
#include "pointmap/volume.glsl"
#include "pointmap/rays.glsl"
#include "pointmap/march.glsl"

void main() {
    uint row = gl_GlobalInvocationID.x;
#if PARTS == 0
    if (row >= uint(u_image.x * u_image.y)) return;
    uint pixel = row;
#else
    if (row >= lists[LIST_PART].count) return;
    uint pixel = part_pixels[row];
#endif
    Ray ray = ray_through(corner_of(pixel) + 0.5);
#if PARTS == 0
    if (meets_parts(ray)) {
        part_pixels[append(LIST_PART)] = pixel;
        return;
    }
#endif
    Hit hit = march(ray);
    ray_t[pixel] = hit.t;
    ray_walked[pixel] = hit.steps | (hit.near ? NEAR : 0u);
    if (hit.suspect != NO_HIT) exact_pixels[append(LIST_EXACT)] = uvec2(pixel, floatBitsToUint(hit.suspect));
}
