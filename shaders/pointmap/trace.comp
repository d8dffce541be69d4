// Step II, first pass: march every pixel's ray from the end of its beam. Reads the volume; writes t and steps per pixel, and
// lists the rays that need the exact walk. PARTS 0: all listed tiles, and rays that meet part boxes are listed for the others.
layout(local_size_x = 64) in;
#include "pointmap/volume.glsl"
#include "pointmap/rays.glsl"
#include "pointmap/march.glsl"

void main() {
    uint count = pixel_count();
#if PARTS == 0
    uint pixel = pixel_of_tile(tiles[gl_WorkGroupID.x], gl_LocalInvocationIndex);
    if (pixel == NO_PIXEL) return;
#else
    const int which = PARTS == 1 ? 0 : PARTS == 2 ? 1 : PARTS == 4 ? 2 : SEVERAL;
    uint row = gl_GlobalInvocationID.x;
    if (row >= lists[LIST_TRACE + which].count) return;
    uint pixel = trace_pixels[uint(which) * count + row];
#endif
    Ray ray = ray_through(corner_of(pixel) + 0.5);
#if PARTS == 0
    if (sees_parts(corner_of(pixel) + 0.5, corner_of(pixel) + 0.5)) {
        int boxes = meets_parts(ray);
        if (boxes != 0) {
            int which = boxes == 1 ? 0 : boxes == 2 ? 1 : boxes == 4 ? 2 : SEVERAL;
            trace_pixels[uint(which) * count + append(LIST_TRACE + which)] = pixel;
            return;
        }
    }
#endif
    Hit hit = march(ray, start_of(pixel, ray));
    ray_t[pixel] = hit.t;
    ray_near[pixel] = hit.near;
    ray_walked[pixel] = hit.steps | (hit.grazes ? GRAZES : 0u) | (PARTS != 0 ? SEES_PARTS : 0u);
    if (hit.suspect != NO_HIT) {
        uint row = from_end(append(LIST_EXACT + int(ANY_PART)), ANY_PART, count);
        exact_pixels[row] = uvec2(pixel, floatBitsToUint(hit.suspect));
    }
}
