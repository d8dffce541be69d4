// (albedo + tint) E(n), sRGB-encoded; E at the vertices (mesh.vert). Backs are not drawn.
in vec2 v_uv;
in vec3 v_gain;
in vec3 v_offset;

uniform sampler2D u_albedo;
uniform float u_lod_bias;

layout(location = 0) out vec4 out_colour;

void main() {
    vec3 texel = texture(u_albedo, v_uv, u_lod_bias).rgb;
    out_colour = vec4(clamp(texel * v_gain + v_offset, 0.0, 1.0), 1.0);
}
