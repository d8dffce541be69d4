// Step II, between the passes: list what is covered, and the pixels along silhouettes that need sub-positions: those
// beside a pixel that differs in being hit, and those whose ray misses the surface by less than a pixel.
layout(local_size_x = 64) in;
#include "pointmap/volume.glsl"
#include "pointmap/rays.glsl"
uniform int u_antialias;

bool is_hit(ivec2 place) {
    place = clamp(place, ivec2(0), u_image - 1);
    return ray_t[place.y * u_image.x + place.x] != NO_HIT;
}

void main() {
    uint pixel = gl_GlobalInvocationID.x;
    if (pixel >= uint(u_image.x * u_image.y)) return;
    atomicAdd(tally_steps, ray_walked[pixel] & ~NEAR);
    ivec2 place = ivec2(corner_of(pixel));
    bool hit = is_hit(place);
    bool edge = !hit && (ray_walked[pixel] & NEAR) != 0u;
    for (int k = 0; k < 9; ++k) edge = edge || is_hit(place + ivec2(k % 3, k / 3) - 1) != hit;
    edge = edge && u_antialias == 1;
    uint slot = NO_SLOT;
    if (edge) {
        slot = append(LIST_EDGE);
        edge_pixels[slot] = pixel;
    }
    if (hit || edge) covered_pixels[append(LIST_COVERED)] = uvec2(pixel, slot);
}
