// Step II, between the passes: list what is covered, and the pixels along edges that need sub-positions: those beside a pixel
// that differs in being hit, those of rays that miss the surface by less than a pixel, and those beside another sheet of it. An
// invocation for each row of a tile, a bit for each of its pixels: atomic operations are what takes time here. BOXED: which tiles; ANTIALIAS: whether
// there are sub-positions.
layout(local_size_x = 8) in;
#include "pointmap/volume.glsl"
#include "pointmap/rays.glsl"

// Which of the `count` pixels of one tile from `place` on are hit, continued beyond the picture's border.
uint hits(ivec2 place, int count) {
    uvec2 pixel = uvec2(clamp(place, ivec2(0), u_image - 1));
    uint from = index_of(pixel), found = 0u;
    if (beam_of(pixel) == EMPTY) return found;
    for (uint k = 0u; k < count; ++k) if (ray_t[from + k] != NO_HIT) found |= 1u << k;
    return found;
}

// Which of the pixels from `first` on that `both` says are hit, as their neighbours are, lie on another sheet than those.
uint jumps(uvec2 first, ivec2 beside, uint both) {
    uint found = 0u;
    for (uint k = 0u; k < 8u; ++k) {
        if ((both >> k & 1u) == 0u) continue;
        uvec2 pixel = first + uvec2(k, 0);
        float t = ray_t[index_of(pixel)], other = ray_t[index_of(uvec2(clamp(ivec2(pixel) + beside, ivec2(0), u_image - 1)))];
        if (abs(other - t) > sheet_gap(pixel, t)) found |= 1u << k;
    }
    return found;
}

uint boxes_of(uint index) { return ray_walked[index] >> BOXES_SHIFT & EVERY_BOX; }

// The boxes, of those that its ray meets, that a pixel's normal may look into.
uint boxes_about(uvec2 pixel, bool hit) {
    uint index = index_of(pixel), boxes = boxes_of(index);
    if (!hit) return boxes;
    vec3 p = at(ray_through(centre_of(pixel)), ray_t[index]);
    for (int k = 0; k < PART_COUNT; ++k) {
        vec3 local = box_place(k, p), beside = vec3(ASIDE * u_voxel);
        if (any(lessThan(local, -beside)) || any(greaterThan(local, in_part[k].size + beside))) boxes &= ~(1u << k);
    }
    return boxes;
}

// The pixels whose four bits say `set`.
uint of_set(uint set, uint sets) {
    uint found = 0u;
    for (uint k = 0u; k < 8u; ++k) if ((sets >> (4 * k) & 15u) == set) found |= 1u << k;
    return found;
}

void main() {
    uvec2 first = place_of(tiles[tile_entry(gl_WorkGroupID.x, BOXED)]) + uvec2(0, gl_LocalInvocationIndex);
    if (!in_picture(first)) return;
    ivec2 place = ivec2(first);
    int count = min(8, u_image.x - place.x);
    uint from = index_of(first), hit = hits(place, count), edge = 0u, steps = 0u, grazes = 0u;
    for (uint k = 0u; k < count; ++k) {
        uint walked = ray_walked[from + k];
        steps += walked & STEPS;
        if ((walked & GRAZES) != 0u) grazes |= 1u << k;
    }
    atomicAdd(tally_steps, steps);
    if (ANTIALIAS == 1) {
        uint left = hit << 1 | hits(place - ivec2(1, 0), 1), right = hit >> 1 | hits(place + ivec2(count, 0), 1) << (count - 1);
        uint above = hits(place - ivec2(0, 1), count), below = hits(place + ivec2(0, 1), count);
        edge = (hit & ~(left & right & above & below)) | (~hit & (left | right | above | below | grazes));
        edge |= jumps(first, NEIGHBOURS[0], hit & left) | jumps(first, NEIGHBOURS[1], hit & right);
        edge |= jumps(first, NEIGHBOURS[2], hit & above) | jumps(first, NEIGHBOURS[3], hit & below);
        edge &= (1u << count) - 1u;
    }
    uint slot = edge != 0u ? atomicAdd(edge_count, uint(bitCount(edge))) : 0u, shown_in = 0u, edge_in = 0u;  // sets, 4 bits each
    for (uint k = 0u; k < count; ++k) {
        uint here = 1u << k;
        uvec2 pixel = first + uvec2(k, 0);
        if (slot >= u_slots) edge &= ~here;
        bool fits = (edge & here) != 0u;
        if (fits) edge_pixels[slot] = word_of(pixel);
        if (fits || (hit & here) != 0u) edge_slot[from + k] = fits ? slot : NO_SLOT;
        if (fits) ++slot;
        if (BOXED == 1) {
            shown_in |= box_set(boxes_about(pixel, (hit & here) != 0u)) << (4 * k);
            edge_in |= box_set(boxes_of(from + k)) << (4 * k);
        }
    }
    for (uint set = 0u; set < (BOXED == 1 ? uint(BOX_SETS) : 1u); ++set) {
        uint shown = of_set(set, shown_in) & (hit | edge), beside = of_set(set, edge_in) & edge;
        uint row = set * pixel_count() + append(LIST_COVERED + int(set), uint(bitCount(shown)));
        uint edge_row = set * u_slots + append(LIST_EDGE + int(set), uint(bitCount(beside)));
        for (uint k = 0u; k < count; ++k) {
            if ((shown >> k & 1u) != 0u) trace_pixels[row++] = word_of(first + uvec2(k, 0));
            if ((beside >> k & 1u) != 0u) edge_slots[edge_row++] = edge_slot[from + k];
        }
    }
}
