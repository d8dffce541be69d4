// Step II, before the first pass: how far the rays of each tile of SIDE x SIDE pixels are free of the body, all at once. A
// beam is a cone about the tile's middle; it goes on while the ball around its middle holds its whole width and more.
// SIDE 8: all that are not EMPTY before, from the camera. SIDE 4: quarters of those, from where these end; lists those that the
// next passes visit. Beams are wider than the neighbours of a tile's pixels: no silhouette runs along an EMPTY one.
layout(local_size_x = 64) in;
#include "pointmap/volume.glsl"
#include "pointmap/rays.glsl"

const int MAX_BALLS = 64;
const float WIDE = SIDE + 3;  // footprints: the tile's half diagonal is SIDE; the march tells grazing rays within 2
const float ENOUGH = 0.5;  // of the beam's width: balls that gain less are not worth a step
const float NARROW = 1e-3; // metres: nor are those
// How far what is stored may exceed the distance: a learned field is steeper than one, and a march looks whether it has
// stepped over the surface, but a beam sees its middle alone.
const float STEEP = 2;        // times
const float TRUSTED = 0.03;   // metres

void main() {
    uint tile = (gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x) * 64u + gl_LocalInvocationIndex;
    if (tile >= (SIDE == 8 ? tile_count() : 4u * tile_count())) return;
    float earlier = SIDE == 8 ? beam_wide[tile] : beam_wide[tile / 4u];
    if (SIDE == 4 && earlier == EMPTY) beam_free[tile] = EMPTY;
    if (earlier == EMPTY) return;  // nobody looks at
    vec2 corner = SIDE == 8 ? corner_of_tile(tile) : corner_of_quarter(tile);
    Ray ray = ray_through(corner + SIDE / 2);
    float away = -ray.camera, wide = WIDE * ray.footprint;
    float spread = 2 * wide / max(2 * away - wide, 1e-3 * away);  // chord between the directions of middle and rim
    // The box grown by the beam's width at its far end, so that no ray of the tile meets it earlier or leaves it later.
    vec3 size = u_voxel * body_last();
    float rim = spread * (away + length(size));
    vec2 range = slab(ray.origin - u_origin + rim, ray.direction, size + 2 * rim);
    float from_camera = max(range.x + away, 0), end = range.y + away, free = NO_HIT;
    if (SIDE == 4) from_camera = max(from_camera, earlier);
    for (int i = 0; i < MAX_BALLS && from_camera < end && free == NO_HIT; ++i) {
        vec3 place = clamp(body_at(ray, from_camera - away), vec3(0), body_last());
        float width = spread * from_camera, sdf = field_filtered(vec3(0), place, PartTruths(false)).sdf;
        float beside = max(sdf / STEEP, sdf - TRUSTED) - width;
        if (beside < ENOUGH * width + NARROW || i == MAX_BALLS - 1) free = from_camera;
        from_camera += beside / (1 + spread);
    }
    if (free == NO_HIT && !sees_parts(corner, corner + SIDE)) free = EMPTY;
    if (SIDE == 8) {
        beam_wide[tile] = free;
        return;
    }
    beam_free[tile] = free;
    if (free != EMPTY) quarters[append(LIST_TILE)] = tile;
}
