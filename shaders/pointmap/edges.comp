// Step II, between the passes: list what is covered, and the pixels along silhouettes that need sub-positions: those
// beside a pixel that differs in being hit, and those of rays that miss the surface by less than a pixel. ANTIALIAS: whether
// there are sub-positions.
layout(local_size_x = 64) in;
#include "pointmap/volume.glsl"
#include "pointmap/rays.glsl"
uniform uint u_slots;  // edge pixels that there is room for

bool is_hit(ivec2 place) {
    place = clamp(place, ivec2(0), u_image - 1);
    return beam_of(place) != EMPTY && ray_t[place.y * u_image.x + place.x] != NO_HIT;
}

void main() {
    uint pixel = pixel_of_tile(tiles[gl_WorkGroupID.x], gl_LocalInvocationIndex);
    if (pixel == NO_PIXEL) return;
    uint walked = ray_walked[pixel], boxes = walked >> BOXES_SHIFT & EVERY_BOX, parts = boxes != 0u ? 1u : 0u, slot = NO_SLOT;
    atomicAdd(tally_steps, walked & STEPS);
    ivec2 place = ivec2(corner_of(pixel)), right = ivec2(1, 0), down = ivec2(0, 1);
    bool hit = is_hit(place), edge = false;
    if (ANTIALIAS == 1) {
        bvec4 beside = bvec4(is_hit(place + right), is_hit(place - right), is_hit(place + down), is_hit(place - down));
        edge = hit ? !all(beside) : any(beside) || (walked & GRAZES) != 0u;
    }
    if (edge) {
        slot = atomicAdd(edge_count, 1u);
        if (slot < u_slots) {
            uint list = boxes_list(boxes);
            edge_pixels[slot] = pixel;
            edge_slots[list * u_slots + append(LIST_EDGE + int(list))] = slot;
        } else {
            slot = NO_SLOT;
        }
    }
    if (hit || slot != NO_SLOT) {
        covered_pixels[from_end(append(LIST_COVERED + int(parts)), parts, pixel_count())] = uvec2(pixel, slot);
    }
}
