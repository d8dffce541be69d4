// One texture vertex of a posed surface: position (m), normal and tint of its vertex in the root frame. Writes clip
// coordinates with the picture's top as the first row. Light is evaluated here: a triangle is some pixels large, so that E of its
// corners' normals is E of every pixel's (55 dB) for less.
#include "lib/light.glsl"

in vec3 in_position;
in vec3 in_normal;
in vec3 in_tint;
in vec2 in_uv;
in float in_lit;  // 1 on body and hands, 0 on the face
in int in_part;  // 0 the body, 1.. in the order of PARTS

uniform mat4 u_clip_from_root;
uniform float u_albedo_scale;
uniform vec3 u_harmonics[8];       // on body and hands
uniform vec3 u_face_harmonics[8];  // on the face
#ifdef LIT  // by the key light of a stage (surface/raster.py, KeyShadow)
layout(binding = CAST_UNIT) uniform sampler2D u_cast;
uniform mat4 u_map_from_root;
uniform vec3 u_key;   // towards the light
uniform vec2 u_gains; // in the shadow, and what the light adds

// Share of the key light: none where the surface turns away, or something is nearer to the light.
float in_light(vec3 position, vec3 normal) {
    vec3 place = (u_map_from_root * vec4(position, 1)).xyz;
    vec2 texel = 1.5 / vec2(textureSize(u_cast, 0));
    float free = 0;
    for (int k = -1; k < 2; k += 2) {
        vec2 at = place.xy + texel * k;
        free += 1 - smoothstep(0.02, 0.06, -textureLod(u_cast, at, 0).y - place.z);
    }
    return 0.5 * free * smoothstep(-0.15, 0.35, dot(normal, u_key));
}
#endif

out vec2 v_uv;
out vec3 v_gain;      // of the texel
out vec3 v_offset;    // sRGB-encoded
out vec3 v_position;  // root frame, metres
out vec3 v_normal;    // root frame, unit at the vertices
out vec3 v_part;      // share of each part
out vec3 v_own;       // the vertex's tint as it is

void main() {
    v_position = in_position;
    v_normal = in_normal;
    vec3 lit = light(v_normal, u_harmonics, DARKEST);
    if (in_lit < 1) lit = mix(light(v_normal, u_face_harmonics, DARKEST), lit, in_lit);
#ifdef LIT
    lit *= u_gains.x + u_gains.y * in_light(v_position, v_normal);
#endif
    v_gain = u_albedo_scale * lit;
    v_own = in_tint;
    v_offset = v_own * lit;
    v_uv = in_uv;
    v_part = vec3(in_part == 1, in_part == 2, in_part == 3);
    gl_Position = u_clip_from_root * vec4(v_position, 1);
}
