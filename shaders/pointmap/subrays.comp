// Step II, antialiasing: 4 x 4 rays through each silhouette pixel; one work group of 64 holds four pixels.
layout(local_size_x = 64) in;
#include "pointmap/volume.glsl"
#include "pointmap/rays.glsl"
#include "pointmap/march.glsl"

void main() {
    uint row = gl_GlobalInvocationID.x;
    uint slot = row / 16u, k = row % 16u;
    if (slot >= lists[LIST_EDGE].count) return;
    Hit hit = march(ray_through(corner_of(edge_pixels[slot]) + (vec2(k % 4u, k / 4u) + 0.5) / 4));
    sub_t[row] = hit.t;
    atomicAdd(tally_steps, hit.steps);
}
