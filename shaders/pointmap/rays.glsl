// The rays of a view, and the buffers between the raycast passes.
// A ray starts on a plane through the volume, not at the camera, so that a camera a kilometre away costs no digits.
struct Ray {
    vec3 origin;
    vec3 direction;
    float camera;     // t of the camera centre, negative
    float footprint;  // half a pixel's diagonal on the plane, metres
    vec3 body_origin;     // the same ray in body voxels
    vec3 body_direction;
    vec2 range;       // where any box is, from the camera on; empty (x > y) where there is none
    PartNumbers entry;  // of the part boxes; entry > exit where missed or not looked at
    PartNumbers exit;
};

Ray ray_through(vec2 pixel) {
    vec3 offset = (pixel.x - u_middle.x) * u_across + (pixel.y - u_middle.y) * u_down;
    vec3 gaze = u_gaze + offset;
    Ray ray;
    ray.origin = u_point + offset;
    ray.camera = -length(gaze);
    ray.direction = gaze / -ray.camera;
    ray.footprint = 0.5 * length(u_across + u_down);
    ray.body_origin = (ray.origin - u_origin) / u_voxel;
    ray.body_direction = ray.direction / u_voxel;
    ray.range = slab(ray.body_origin, ray.body_direction, body_last());
    if (ray.range.x > ray.range.y) ray.range = vec2(NOWHERE, -NOWHERE);
    ray.entry = PartNumbers(NOWHERE);
    ray.exit = PartNumbers(-NOWHERE);
    for (int k = 0; k < PART_COUNT; ++k) {
        if (!looks_at(k)) continue;
        vec2 box = slab(box_place(k, ray.origin), mat3(in_part[k].box_from_root) * ray.direction, in_part[k].size);
        // A box that is missed must not say where steps end: what a ray meets depends on nothing else.
        if (in_part[k].size.x < 0 || box.x > box.y || box.y < ray.camera) box = vec2(NOWHERE, -NOWHERE);
        ray.entry[k] = box.x;
        ray.exit[k] = box.y;
        ray.range = vec2(min(ray.range.x, box.x), max(ray.range.y, box.y));
    }
    ray.range.x = max(ray.range.x, ray.camera);
    return ray;
}

const float ASIDE = 0.5;  // voxels by which normals look aside, at most of the body

// Whether any part box may be seen between two corners of the picture.
bool sees_parts(vec2 low, vec2 high) {
    bool sees = false;
    for (int k = 0; k < PART_COUNT; ++k) {
        vec4 window = in_part[k].window;
        sees = sees || all(greaterThanEqual(high, window.xy)) && all(lessThanEqual(low, window.zw));
    }
    return sees;
}

// Which part boxes the ray, as wide as a pixel, meets: a bit each.
uint meets_parts(Ray ray) {
    uint meets = 0u;
    for (int k = 0; k < PART_COUNT; ++k) {
        vec3 place = box_place(k, ray.origin), size = in_part[k].size;
        float grown = ray.footprint * (1 - (length(place) + length(size)) / ray.camera) + ASIDE * u_voxel;
        vec2 box = slab(place + grown, mat3(in_part[k].box_from_root) * ray.direction, size + 2 * grown);
        if (size.x >= 0 && box.x <= box.y && box.y >= ray.camera) meets |= 1u << k;
    }
    return meets;
}

vec3 at(Ray ray, float t) { return ray.origin + t * ray.direction; }

vec3 body_at(Ray ray, float t) { return ray.body_origin + t * ray.body_direction; }

PartTruths boxes_at(Ray ray, float t) {
    PartTruths inside;
    for (int k = 0; k < PART_COUNT; ++k) inside[k] = t >= ray.entry[k] && t <= ray.exit[k];
    return inside;
}

// Metres to the next box entry.
float reach_at(Ray ray, float t) {
    return least(mix(PartNumbers(NOWHERE), ray.entry - t, greaterThan(ray.entry, PartNumbers(t))));
}

// Lists for the next passes, each an indirect dispatch of as many work groups as it takes, counted as they are appended. Tiles
// come twice, a work group each: those in which no part box is seen, and those in which one may be. Pixels to be traced, walked
// exactly, shown (64 in a group) and along silhouettes (4, of 16 rays each) come for each set of part boxes that their rays meet:
// a program that looks at fewer boxes is faster.
const int BOX_SETS = PART_COUNT + 2, LIST_TILE = 0, LIST_TRACE = 2, LIST_EXACT = LIST_TRACE + BOX_SETS,
          LIST_COVERED = LIST_EXACT + BOX_SETS, LIST_EDGE = LIST_COVERED + BOX_SETS;

// The set of part boxes (a bit each): none, one part, several.
uint box_set(uint boxes) { return bitCount(boxes) > 1 ? uint(PART_COUNT + 1) : uint(findMSB(boxes) + 1); }
struct List { uint groups, one, also_one, count; };
layout(std430, binding = 1) buffer Lists { List lists[LIST_EDGE + BOX_SETS]; uint tally_steps; uint edge_count; };
layout(std430, binding = 2) buffer TracePixels { uint trace_pixels[]; };      // room for all in each set; when they are traced, those to be shown
struct Suspect { uint pixel; float from; float to; };                          // t between which a hit may have been missed
layout(std430, binding = 3) buffer Suspects { Suspect suspects[]; };           // room for all in each set
layout(std430, binding = 4) buffer EdgePixels { uint edge_pixels[]; };
layout(std430, binding = 5) buffer EdgeSlot { uint edge_slot[]; };             // per pixel that is shown: slot among the edges or NO_SLOT
layout(std430, binding = 6) buffer Distance { float ray_t[]; };                // per pixel; NO_HIT where none
layout(std430, binding = 7) buffer Approach { vec2 ray_free[]; };              // per pixel: t up to which it is free, and from which again
layout(std430, binding = 8) buffer Walked { uint ray_walked[]; };              // per pixel: steps and the bits below
layout(std430, binding = 9) buffer SubDistance { float sub_t[]; };             // per edge slot, 16
layout(std430, binding = 10) buffer Beams { float beam_free[]; };              // per tile: metres from the camera, NO_HIT: all; or EMPTY
layout(std430, binding = 11) buffer Tiles { uint tiles[]; };                   // that are not EMPTY: the places of their first pixels
layout(std430, binding = 13) buffer EdgeSlots { uint edge_slots[]; };          // room for all in each set

const float NO_HIT = 1e9;
const float EMPTY = 2e9;               // of a tile without hits; no pass visits its pixels
const uint NO_SLOT = 0xffffffffu;
const uint GRAZES = 0x80000000u;       // the ray misses the surface by less than a pixel
const int BOXES_SHIFT = 31 - PART_COUNT;  // a bit each: the part boxes that the ray meets
const uint STEPS = (1u << BOXES_SHIFT) - 1u, EVERY_BOX = (1u << PART_COUNT) - 1u;

// Room for `more` entries of a list; where the first of them is.
uint append(int list, uint more) {
    if (more == 0u) return 0u;
    uint first = atomicAdd(lists[list].count, more), last = first + more, a_group = list >= LIST_EDGE ? 4u : 64u;
    uint groups = (last + a_group - 1u) / a_group - (first + a_group - 1u) / a_group;
    if (groups > 0u) atomicAdd(lists[list].groups, groups);
    return first;
}

uint pixel_count() { return uint(u_image.x * u_image.y); }

// Where the entry `row` of this program's set is among pixels that there is room for in each; NO_SLOT past the list's end.
uint listed(int list, uint row) {
    uint set = box_set(PARTS);
    return row < lists[list + int(set)].count ? set * pixel_count() + row : NO_SLOT;
}

// Pixels and tiles are listed by their place, 16 bits each way: processors divide integers one after the other.
uint word_of(uvec2 place) { return place.y << 16 | place.x; }

uvec2 place_of(uint word) { return uvec2(word & 0xffffu, word >> 16); }

uint index_of(uvec2 pixel) { return pixel.y * uint(u_image.x) + pixel.x; }

vec2 centre_of(uvec2 pixel) { return vec2(pixel) + 0.5; }

// Occlusion edges: neighbours whose hits are farther apart than SHEET_GAP pixel widths are on two sheets of the surface.
const ivec2 NEIGHBOURS[4] = ivec2[](ivec2(-1, 0), ivec2(1, 0), ivec2(0, -1), ivec2(0, 1));  // as in occlusion_edges.py

float sheet_gap(uvec2 pixel, float t) {
    vec2 away = centre_of(pixel) - u_middle;
    return SHEET_GAP * length(u_across) * (1 + t / length(u_gaze + away.x * u_across + away.y * u_down));
}

// Work groups are tiles of 8 x 8 pixels, each eight invocations 4 x 2 of them: what runs together should look alike.
uint tiles_across() { return (uint(u_image.x) + 7u) / 8u; }

uint tile_count() { return tiles_across() * ((uint(u_image.y) + 7u) / 8u); }

// The first pixel of a tile.
uvec2 corner_of_tile(uint tile) { return 8u * uvec2(tile % tiles_across(), tile / tiles_across()); }

uvec2 pixel_of_tile(uvec2 corner, uint k) {
    return corner + uvec2((k & 3u) | (k >> 1 & 4u), (k >> 2 & 1u) | (k >> 3 & 6u));
}

bool in_picture(uvec2 pixel) { return all(lessThan(pixel, uvec2(u_image))); }

// Tiles in which no box is seen are listed from the front, the others from the back.
uint tile_entry(uint row, uint boxed) { return boxed == 0u ? row : tile_count() - 1u - row; }

float beam_of(uvec2 pixel) { return beam_free[(pixel.y >> 3) * tiles_across() + (pixel.x >> 3)]; }

// The neighbour, of those that are hit, that is farthest before or behind t, on another sheet; -1 where all are on the same one.
int other_sheet(uvec2 pixel, float t, out float other) {
    float most = sheet_gap(pixel, t);
    int found = -1;
    for (int k = 0; k < 4; ++k) {
        ivec2 place = ivec2(pixel) + NEIGHBOURS[k];
        if (any(lessThan(place, ivec2(0))) || any(greaterThanEqual(place, u_image)) || beam_of(uvec2(place)) == EMPTY) continue;
        float beside = ray_t[index_of(uvec2(place))];
        if (beside == NO_HIT || abs(beside - t) <= most) continue;
        most = abs(beside - t);
        other = beside;
        found = k;
    }
    return found;
}

// t from which a pixel's ray may meet something: the body where its beam ends, a part not before its box.
float start_of(uvec2 pixel, Ray ray) {
    float free = beam_of(pixel), start = free == NO_HIT ? NOWHERE : free + ray.camera;
    if (PARTS != 0) start = min(start, least(ray.entry));
    return start;
}
