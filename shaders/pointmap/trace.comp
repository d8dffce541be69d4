// Step II, first pass: march every pixel's ray from the end of its beam. Reads the volume; writes t and steps per pixel, and
// lists the rays that need the exact walk. PARTS 0: all listed tiles, and rays that meet a part box are listed for PARTS 1.
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
    uint row = listed(LIST_TRACE, gl_GlobalInvocationID.x, count);
    if (row == NO_SLOT) return;
    uint pixel = trace_pixels[row];
#endif
    Ray ray = ray_through(corner_of(pixel) + 0.5);
#if PARTS == 0
    if (sees_parts(corner_of(pixel) + 0.5, corner_of(pixel) + 0.5) && meets_parts(ray)) {
        trace_pixels[from_end(append(LIST_TRACE, 1u), 1u, count)] = pixel;
        return;
    }
#endif
    Hit hit = march(ray, start_of(pixel, ray));
    ray_t[pixel] = hit.t;
    ray_near[pixel] = hit.near;
    ray_walked[pixel] = hit.steps | (hit.grazes ? GRAZES : 0u) | (PARTS == 1 ? SEES_PARTS : 0u);
    if (hit.suspect != NO_HIT) {
        uint row = from_end(append(LIST_EXACT, uint(PARTS)), uint(PARTS), count);
        exact_pixels[row] = uvec2(pixel, floatBitsToUint(hit.suspect));
    }
}
