// How much of the key light and of the sky points see: cones marched through a distance field, as `_reference` in
// avatarrex/stage/visibility.py has it. Reads points, begun off their surface, and unit normals; writes two shares each. Root frame, metres.
layout(local_size_x = 64) in;
#include "lib/trilinear.glsl"
#include "lib/slab.glsl"

struct Place { vec4 point, normal; };
layout(std430, binding = 0) readonly buffer Points { Place in_place[]; };
layout(std430, binding = 1) writeonly buffer Shares { vec2 out_share[]; };
layout(binding = 0) uniform sampler3D u_distance;
uniform vec3 u_origin;  // of voxel 0
uniform float u_voxel;
uniform vec3 u_last;    // the last voxel (the texture may be larger)
uniform vec3 u_key;     // towards the light, unit
uniform float u_width;  // tangent of its angular radius
uniform int u_count;

float distance_at(vec3 p) {
    vec3 place = (p - u_origin) / u_voxel, within = clamp(place, vec3(0), u_last);
    return trilinear_filtered(u_distance, within).x + u_voxel * length(place - within);
}

float share(float free) {
    float r = clamp(free, -1.0, 1.0);
    return 0.25 * (1 + r) * (1 + r) * (2 - r);
}

float narrow_cone(vec3 origin, vec3 axis) {
    float t = LEAST_STEP, free = 1;
    for (int k = 0; k < KEY_STEPS && t < REACH && free > -1; ++k) {
        float d = distance_at(origin + t * axis);
        free = min(free, d / (u_width * t));
        t += clamp(STEP * abs(d), LEAST_STEP, LONGEST_STEP);
    }
    return share(free);
}

float wide_cone(vec3 origin, vec3 axis) {
    float t = SKY_START, free = 1;
    for (int k = 0; k < SKY_STEPS; ++k) {
        free = min(free, distance_at(origin + t * axis) / (SKY_WIDTH * t));
        t *= SKY_GROWTH;
    }
    return share(free);
}

void main() {
    uint row = (gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x) * 64u + gl_LocalInvocationIndex;
    if (row >= uint(u_count)) return;
    vec3 origin = in_place[row].point.xyz, normal = in_place[row].normal.xyz;
    float facing = smoothstep(RAMP_FROM, RAMP_TO, dot(normal, u_key));
    float key = facing > 0 ? facing * narrow_cone(origin, u_key) : 0.0;
    vec3 side = abs(normal.x) > 0.8 ? vec3(0, 0, 1) : vec3(1, 0, 0);
    vec3 across = normalize(cross(normal, side)), along = cross(normal, across);
    float sky = CENTRE * wide_cone(origin, normal);
    for (int k = 0; k < AROUND; ++k) {
        float turn = 6.2831853072 * k / AROUND;
        sky += RING * wide_cone(origin, 0.5 * normal + sqrt(0.75) * (cos(turn) * across + sin(turn) * along));
    }
    out_share[row] = vec2(key, sky);
}
