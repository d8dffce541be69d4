// Step II, first pass: march every pixel's ray from the end of its beam. Reads the volume; writes t and steps per pixel, and
// lists the rays that need the exact walk. PARTS 0: listed tiles, BOXED those in which a part box may be seen; rays that meet one
// are listed for the other programs.
layout(local_size_x = 64) in;
#include "pointmap/volume.glsl"
#include "pointmap/rays.glsl"
#include "pointmap/march.glsl"

void main() {
#if PARTS == 0
    uvec2 pixel = pixel_of_tile(place_of(tiles[tile_entry(gl_WorkGroupID.x, BOXED)]), gl_LocalInvocationIndex);
    if (!in_picture(pixel)) return;
#else
    uint row = listed(LIST_TRACE, gl_GlobalInvocationID.x);
    if (row == NO_SLOT) return;
    uvec2 pixel = place_of(trace_pixels[row]);
#endif
    Ray ray = ray_through(centre_of(pixel));
#if BOXED == 1
    if (sees_parts(centre_of(pixel), centre_of(pixel))) {
        uint set = box_set(meets_parts(ray));
        if (set != 0u) {
            trace_pixels[set * pixel_count() + append(LIST_TRACE + int(set), 1u)] = word_of(pixel);
            return;
        }
    }
#endif
    uint index = index_of(pixel);
    Hit hit = march(ray, start_of(pixel, ray), NOWHERE, true);
    ray_free[index] = vec2(hit.near, hit.far);
    ray_walked[index] = hit.steps | (hit.grazes ? GRAZES : 0u) | uint(PARTS) << BOXES_SHIFT;
    ray_t[index] = hit.t;
    if (hit.suspect.x != NO_HIT) {
        uint set = box_set(PARTS);
        suspects[set * pixel_count() + append(LIST_EXACT + int(set), 1u)] = Suspect(word_of(pixel), hit.suspect.x, hit.suspect.y);
    }
}
