// Step II, antialiasing: 4 x 4 rays through each pixel of an edge; one work group of 64 holds four pixels.
layout(local_size_x = 64) in;
#include "pointmap/volume.glsl"
#include "pointmap/rays.glsl"
#include "pointmap/march.glsl"

void main() {
    uint row = gl_GlobalInvocationID.x / 16u, k = gl_GlobalInvocationID.x % 16u;
    uint set = box_set(PARTS);
    if (row >= lists[LIST_EDGE + int(set)].count) return;
    uint slot = edge_slots[set * u_slots + row];
    uvec2 pixel = place_of(edge_pixels[slot]);
    // Where the pixel's centre hits and no neighbour shows another sheet, its sub-rays are only counted.
    Ray ray = ray_through(vec2(pixel) + (vec2(k % 4u, k / 4u) + 0.5) / 4);
    uint index = index_of(pixel);
    float t = ray_t[index], other;
    bool misses = t == NO_HIT, close = misses || other_sheet(pixel, t, other) >= 0;
    vec2 free = ray_free[index];
    Hit hit = march(ray, free.x, misses ? free.y : NOWHERE, close);
    sub_t[slot * 16u + k] = hit.t;
    atomicAdd(tally_steps, hit.steps);
}
