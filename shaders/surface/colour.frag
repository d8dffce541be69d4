// (albedo + tint) E(n), sRGB-encoded. Backs are not drawn.
#include "lib/light.glsl"

in vec2 v_uv;
in vec3 v_normal;
in vec3 v_tint;
in float v_lit;

uniform sampler2D u_albedo;
uniform float u_albedo_scale;
uniform vec3 u_harmonics[8];

layout(location = 0) out vec4 out_colour;

void main() {
    vec3 normal = normalize(v_normal);
    vec3 lit = mix(vec3(1), light(normal, u_harmonics, DARKEST), v_lit);
    vec3 albedo = texture(u_albedo, v_uv, LOD_BIAS).rgb * u_albedo_scale;
    out_colour = vec4(clamp((albedo + v_tint) * lit, 0.0, 1.0), 1.0);
}
