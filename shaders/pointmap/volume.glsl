// The volume as the raycast passes read it. Root frame, metres.
// PART_COUNT: lib/parts.glsl; CONTACT_UNIT: after their textures. BRICKS: whether cells of the body grid are refined; PARTS: which part boxes are looked at, a bit each; CONTACTS: whether any
// box has a contact block; FLOAT_FILTER: whether the texture unit interpolates in float, as Mesa's software renderers do
// (probe.comp found out).
#include "lib/trilinear.glsl"
#include "lib/composition.glsl"
#include "lib/slab.glsl"

// Mirrors PART in avatarrex/pointmap/raycast_gl.py.
struct Part {
    mat4 box_from_root;
    vec3 size;           // of the box, metres; negative where there is no such part
    float voxel;
    vec3 contact_first;  // x y z, body voxels
    int contact;         // 1 where the part has a contact block
    vec4 window;         // pixels from which the box may be seen: x and y from, x and y to
};
layout(std140, binding = 0) uniform Parts { Part in_part[PART_COUNT]; };
// Mirrors VIEW there: the body grid, and the rays of a view.
layout(std140, binding = 1) uniform View {
    vec3 u_origin;     // centre of the body grid's voxel 0
    float u_voxel;     // side of a body voxel
    vec3 u_last;       // the last body voxel (the texture may be larger)
    float u_brick_side;  // fine voxels along a body voxel
    vec3 u_point;      // root metres
    float u_brick_row;
    vec3 u_gaze;       // u_point minus the camera centre
    uint u_slots;      // edge pixels that there is room for
    vec3 u_across;     // on the plane, metres per pixel
    vec3 u_down;
    vec2 u_middle;     // pixel position of the ray that meets the plane in u_point
    ivec2 u_image;     // width, height
};
layout(binding = 0) uniform sampler3D u_body;  // with bricks: behind the grid's layers theirs, u_brick_row along x and y
layout(binding = 3) uniform sampler3D u_part[PART_COUNT];
layout(binding = CONTACT_UNIT) uniform sampler3D u_contact[PART_COUNT];
layout(binding = 1) uniform sampler3D u_brick_number;  // per body cell, from 1; 0 where there is none

struct Field {
    float sdf;
    float bound;  // how far a ray may step
    float voxel;  // side of the finest voxels that are stored here
    float scale;  // side of the voxels that the surface is made of, body and part mixed by omega
    PartNumbers weight;  // effective omega
};

vec3 body_last() { return u_last; }

vec3 box_place(int k, vec3 p) { return (in_part[k].box_from_root * vec4(p, 1)).xyz; }

bool looks_at(int k) { return (PARTS >> k & 1) != 0; }

bool in_box(int k, vec3 p) {
    vec3 local = box_place(k, p);
    return all(greaterThanEqual(local, vec3(0))) && all(lessThanEqual(local, in_part[k].size));
}

vec3 cell_of(vec3 place) { return clamp(floor(place), vec3(0), u_last - 1); }

// Which brick refines a cell, from 0; negative where none does.
float brick_of(vec3 cell) { return texelFetch(u_brick_number, ivec3(cell), 0).x - 1; }

// Where `place` (body voxels) is stored in u_body: in a brick or, with `brick` negative, in the grid. Divided as floats, half a
// brick off: processors have no division of several integers at once.
vec3 stored_place(vec3 place, vec3 cell, float brick) {
    float row = u_brick_row, line = floor((brick + 0.5) / row), layer = floor((line + 0.5) / row);
    vec3 tile = vec3(brick - line * row, line - layer * row, layer) * (u_brick_side + 1) + vec3(0, 0, u_last.z + 1);
    vec3 within = clamp(place - cell, 0, 1);
    return brick < 0 ? cell + within : tile + within * u_brick_side;
}

vec3 body_place(vec3 p) { return (p - u_origin) / u_voxel; }

// Textures are chosen by a literal: llvmpipe takes a computed index from a lane that may have left the loop.
#define ADD_PART(SAMPLE, K) \
    if (looks_at(K) && inside[K]) { \
        vec2 part = SAMPLE(u_part[K], box_place(K, p) / in_part[K].voxel); \
        vec2 pair = vec2(body, NOWHERE); \
        if (CONTACTS == 1 && in_part[K].contact == 1) pair = SAMPLE(u_contact[K], place - in_part[K].contact_first); \
        compose_part(sum, K, part, pair); \
        f.voxel = min(f.voxel, in_part[K].voxel); \
        f.scale = min(f.scale, mix(cell, in_part[K].voxel, part.y)); \
    }

// The composed field at p; `place` is p in body voxels, `inside` says which boxes contain it. SAMPLE is one of the two of
// lib/trilinear.glsl.
#define DEFINE_FIELD(NAME, SAMPLE) \
Field NAME(vec3 p, vec3 place, PartTruths inside) { \
    float cell = u_voxel; \
    vec3 stored = place; \
    if (BRICKS == 1) { \
        vec3 cell_place = cell_of(place); \
        float brick = brick_of(cell_place); \
        stored = stored_place(place, cell_place, brick); \
        if (brick >= 0) cell /= u_brick_side; \
    } \
    float body = SAMPLE(u_body, stored).x; \
    Field f = Field(body, abs(body), cell, cell, PartNumbers(0)); \
    if (PARTS == 0) return f; \
    body += u_voxel * length(place - clamp(place, vec3(0), body_last())); \
    Composition sum = compose_nothing(); \
    EACH_PART(ADD_PART, SAMPLE) \
    f.sdf = compose_sdf(sum, body); \
    f.bound = compose_step(sum, f.sdf); \
    f.weight = compose_weight(sum); \
    return f; \
}
DEFINE_FIELD(field_filtered, trilinear_filtered)
#if FLOAT_FILTER == 1
#define field_at field_filtered
#else
DEFINE_FIELD(field_at, trilinear)
#endif
