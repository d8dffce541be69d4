// Step II, last pass: what the covered pixels see. Writes one record per listed pixel; only these are read back.
layout(local_size_x = 64) in;
#include "pointmap/volume.glsl"
#include "pointmap/rays.glsl"

// Mirrors RECORD in avatarrex/pointmap/raycast_gl.py.
struct Record {
    vec3 position;  // root metres
    uint pixel;     // index; top bit: the ray through the centre hits
    vec3 normal;
    float coverage;
    float weight[PART_COUNT];  // effective omega
    uint walked;    // steps of the centre's ray (STEP_BITS), sub-positions on another sheet (5 bits), which neighbour shows that
};
layout(std430, binding = 12) writeonly buffer Records { Record out_record[]; };

PartTruths boxes_around(vec3 p) {
    PartTruths inside = PartTruths(false);
    for (int k = 0; k < PART_COUNT; ++k) inside[k] = looks_at(k) && in_box(k, p);
    return inside;
}

void main() {
    uint row = listed(LIST_COVERED, gl_GlobalInvocationID.x);
    if (row == NO_SLOT) return;
    uvec2 pixel = place_of(trace_pixels[row]);
    uint index = index_of(pixel), slot = edge_slot[index];
    float t = ray_t[index];
    bool hit = t != NO_HIT;
    float coverage = hit ? 1 : 0;
    vec2 place = vec2(0.5);
    uint others = 0u;
    int sheet = -1;
    if (slot != NO_SLOT) {
        float other = NO_HIT;
        if (hit) sheet = other_sheet(pixel, t, other);
        // Where the centre misses, the covered sub-position nearest to it speaks for the pixel.
        float nearest = NO_HIT;
        coverage = 0;
        for (uint k = 0u; k < 16u; ++k) {
            float sub = sub_t[slot * 16u + k];
            if (sub == NO_HIT) continue;
            coverage += 1.0 / 16;
            if (sheet >= 0 && abs(sub - other) < abs(sub - t)) ++others;
            vec2 offset = (vec2(k % 4u, k / 4u) + 0.5) / 4;
            float away = dot(offset - 0.5, offset - 0.5);
            if (!hit && away < nearest) { nearest = away; t = sub; place = offset; }
        }
        if (hit) coverage = max(coverage, 1.0 / 16);
    }
    Ray ray = ray_through(vec2(pixel) + place);
    vec3 p = at(ray, t);
    // Seven samples through one call: the point, then central differences half a local voxel apart.
    Field here;
    vec3 normal = vec3(0);
    float reach = 0;
    for (int j = 0; j < 7; ++j) {
        vec3 offset = vec3(0);
        if (j > 0) offset[(j - 1) >> 1] = (j & 1) == 1 ? reach : -reach;
        Field f = field_at(p + offset, body_place(p + offset), boxes_around(p + offset));
        if (j == 0) { here = f; reach = ASIDE * f.scale; }
        else normal += f.sdf * sign(offset);
    }
    Record r;
    r.position = p;
    r.pixel = index | (hit ? 0x80000000u : 0u);
    r.normal = normal / max(length(normal), 1e-12);
    r.coverage = coverage;
    for (int k = 0; k < PART_COUNT; ++k) r.weight[k] = here.weight[k];
    r.walked = min(ray_walked[index] & STEPS, (1u << STEP_BITS) - 1u) | others << STEP_BITS | uint(max(sheet, 0)) << (STEP_BITS + 5);
    uint before = 0u;
    for (int set = 0; set < int(box_set(PARTS)); ++set) before += lists[LIST_COVERED + set].count;
    out_record[before + gl_GlobalInvocationID.x] = r;
}
