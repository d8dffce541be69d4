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
    const uint list = boxes_list(PARTS);
    uint row = gl_GlobalInvocationID.x;
    if (row >= lists[LIST_TRACE + list].count) return;
    uint pixel = trace_pixels[(list - 1) * count + row];
#endif
    Ray ray = ray_through(corner_of(pixel) + 0.5);
#if PARTS == 0
    if (sees_parts(corner_of(pixel) + 0.5, corner_of(pixel) + 0.5)) {
        uint list = boxes_list(meets_parts(ray));
        if (list != 0u) {
            trace_pixels[(list - 1) * count + append(LIST_TRACE + int(list))] = pixel;
            return;
        }
    }
#endif
    Hit hit = march(ray, start_of(pixel, ray), true);
    ray_t[pixel] = hit.t;
    ray_near[pixel] = hit.near;
    ray_walked[pixel] = hit.steps | (hit.grazes ? GRAZES : 0u) | uint(PARTS) << BOXES_SHIFT;
    if (hit.suspect != NO_HIT) {
        uint row = from_end(append(LIST_EXACT + int(ANY_PART)), ANY_PART, count);
        exact_pixels[row] = uvec2(pixel, floatBitsToUint(hit.suspect));
    }
}
