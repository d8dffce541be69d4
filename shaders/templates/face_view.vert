// One orthographic view of the face mesh: places in the head-frame cube [-1,1]^3 to the view's image plane.
// Reads vertices; writes clip coordinates with the image's top as the first row, so that pixels are read back in order.
#define DEPTH_RANGE 0.25  // parts of the head behind the cube stay inside the clip volume

in vec3 in_position;  // normalised head frame
in vec3 in_albedo;    // sRGB
in vec3 in_normal;    // unit, head frame

uniform mat3 u_axes_from_head;  // to (image right, image up, towards the camera)

out vec3 v_albedo;
out vec3 v_normal;

void main() {
    vec3 place = u_axes_from_head * in_position;
    gl_Position = vec4(place.x, -place.y, -DEPTH_RANGE * place.z, 1);
    v_albedo = in_albedo;
    v_normal = in_normal;
}
