// What Step II is compared with in `bench raycast`: one pass over all pixels, boxes included, no refinement list.
// METHOD 0: fixed steps of a quarter of the voxel that is there, and one linear interpolation. METHOD 1: sphere tracing
// to 1e-4 m. METHOD 2: as 0, by a quarter of the body's voxel everywhere (the level `paper`).
layout(local_size_x = 64) in;
#include "pointmap/volume.glsl"
#include "pointmap/rays.glsl"

void main() {
    uint tile = gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x;
    if (tile >= tile_count()) return;
    if (gl_LocalInvocationIndex == 0u) {  // the next passes visit every tile
        uint boxed = PARTS != 0 ? 1u : 0u;
        tiles[tile_entry(atomicAdd(lists[LIST_TILE + int(boxed)].groups, 1u), boxed)] = word_of(corner_of_tile(tile));
        beam_free[tile] = 0;
    }
    uvec2 pixel = pixel_of_tile(corner_of_tile(tile), gl_LocalInvocationIndex);
    if (!in_picture(pixel)) return;
    Ray ray = ray_through(centre_of(pixel));
    float t = ray.range.x, s = 0, s_before = -1, before = t;
    bool found = false;
    uint steps = 0u;
    for (int i = 0; i < 2000; ++i) {
        if (t > ray.range.y) break;
        Field f = field_filtered(at(ray, t), body_at(ray, t), boxes_at(ray, t));
        s = f.sdf;
        ++steps;
        found = METHOD == 1 ? s < 1e-4 : s < 0 && s_before >= 0;
        if (found) break;
        before = t;
        s_before = s;
        t += METHOD == 1 ? min(max(f.bound, 1e-4), max(reach_at(ray, t), 1e-6)) : 0.25 * (METHOD == 0 ? f.scale : u_voxel);
    }
    if (METHOD != 1) t = before + (t - before) * s_before / max(s_before - s, 1e-12);
    ray_t[index_of(pixel)] = found ? t : NO_HIT;
    ray_walked[index_of(pixel)] = steps | uint(PARTS) << BOXES_SHIFT;
}
