// Step II, before the first pass: how far the rays of each tile of 8 x 8 pixels are free of the body, all at once. A
// beam is a cone about the tile's middle; it goes on while the ball around its middle holds its whole width and more.
// Tiles that are EMPTY before stay so.
// Lists the tiles that the next passes visit. Beams are wider than the neighbours of a tile's pixels: no silhouette runs
// along an EMPTY one.
layout(local_size_x = 64) in;
#include "pointmap/volume.glsl"
#include "pointmap/rays.glsl"

const int MAX_BALLS = 64;
const float WIDE = 11;   // footprints: the tile's half diagonal is 8; the march tells grazing rays within 2
const float ENOUGH = 0.5;  // of the beam's width: balls that gain less are not worth a step
const float NARROW = 1e-3; // metres: nor are those
// How far what is stored may exceed the distance: a learned field is steeper than one, and a march looks whether it has
// stepped over the surface, but a beam sees its middle alone.
const float STEEP = 2;        // times
const float TRUSTED = 0.03;   // metres

void main() {
    uint tile = (gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x) * 64u + gl_LocalInvocationIndex;
    if (tile >= tile_count()) return;
    if (beam_free[tile] == EMPTY) return;  // nobody looks at
    uvec2 first = corner_of_tile(tile);
    vec2 corner = vec2(first);
    Ray ray = ray_through(corner + 4);
    float away = -ray.camera, wide = WIDE * ray.footprint;
    float spread = 2 * wide / max(2 * away - wide, 1e-3 * away);  // chord between the directions of middle and rim
    // The box grown by the beam's width at its far end, so that no ray of the tile meets it earlier or leaves it later.
    vec3 size = u_voxel * body_last();
    float rim = spread * (away + length(size));
    vec2 range = slab(ray.origin - u_origin + rim, ray.direction, size + 2 * rim);
    float from_camera = max(range.x + away, 0), end = range.y + away, free = NO_HIT;
    for (int i = 0; i < MAX_BALLS && from_camera < end && free == NO_HIT; ++i) {
        vec3 place = clamp(body_at(ray, from_camera - away), vec3(0), body_last());
        float width = spread * from_camera, sdf = field_filtered(vec3(0), place, PartTruths(false)).sdf;
        float beside = max(sdf / STEEP, sdf - TRUSTED) - width;
        if (beside < ENOUGH * width + NARROW || i == MAX_BALLS - 1) free = from_camera;
        from_camera += beside / (1 + spread);
    }
    uint boxed = sees_parts(corner, corner + 8) ? 1u : 0u;
    if (free == NO_HIT && boxed == 0u) free = EMPTY;
    beam_free[tile] = free;
    if (free != EMPTY) tiles[tile_entry(atomicAdd(lists[LIST_TILE + int(boxed)].groups, 1u), boxed)] = word_of(first);
}
