// The exact picture faded in over the surface, both over a background.
// Reads premultiplied sRGB-encoded colours; writes straight alpha, as the interface blends it.

uniform sampler2D u_surface;
uniform sampler2D u_exact;
uniform float u_weight;       // share of the exact picture, 0 to 1
uniform vec4 u_background;    // premultiplied

in vec2 v_uv;
out vec4 out_colour;

void main() {
    vec4 colour = mix(texture(u_surface, v_uv), texture(u_exact, v_uv), u_weight);
    colour += (1.0 - colour.a) * u_background;
    out_colour = vec4(colour.rgb / max(colour.a, 1e-6), colour.a);
}
