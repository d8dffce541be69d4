// A straight-alpha picture into a window that the desktop composes with premultiplied colours. Row 0 is at the top.

uniform sampler2D u_picture;

in vec2 v_uv;
out vec4 out_colour;

void main() {
    vec4 colour = texture(u_picture, vec2(v_uv.x, 1.0 - v_uv.y));
    out_colour = vec4(colour.rgb * colour.a, colour.a);
}
