// Step II, antialiasing: 4 x 4 rays through each silhouette pixel; one work group of 64 holds four pixels.
layout(local_size_x = 64) in;
#include "pointmap/volume.glsl"
#include "pointmap/rays.glsl"
#include "pointmap/march.glsl"
uniform uint u_slots;

void main() {
    uint row = gl_GlobalInvocationID.x / 16u, k = gl_GlobalInvocationID.x % 16u;
    const uint list = boxes_list(PARTS);
    if (row >= lists[LIST_EDGE + list].count) return;
    uint slot = edge_slots[list * u_slots + row], pixel = edge_pixels[slot];
    // Where the pixel's centre hits, its sub-rays are only counted.
    Hit hit = march(ray_through(corner_of(pixel) + (vec2(k % 4u, k / 4u) + 0.5) / 4), ray_near[pixel], ray_t[pixel] == NO_HIT);
    sub_t[slot * 16u + k] = hit.t;
    atomicAdd(tally_steps, hit.steps);
}
