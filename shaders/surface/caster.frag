// Heights over the floor, blended to the least and (negative) the greatest of a ray. What lies below the floor throws no shadow.
in float v_height;

layout(location = 0) out vec2 out_heights;

void main() {
    if (v_height < 0.0) discard;
    out_heights = vec2(v_height, -v_height);
}
