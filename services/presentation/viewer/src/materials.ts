// Materials of the views. Both extend three's physical material by a few lines of shader.
import * as THREE from "three";

/** Colours of the map from near to far (after "batlow" and "magma": even in lightness, readable by the colour-blind). */
const kMapColors = [0x15365c, 0x1f6680, 0x3a8f7f, 0x86ab55, 0xd8b13f, 0xf08a3c, 0xe2533f, 0xb01e4f];

export function mapGradient(): string {
  const stops = kMapColors.map((c) => `#${c.toString(16).padStart(6, "0")}`);
  return `linear-gradient(to top, ${stops.join(", ")})`;
}

function mapTexture(): THREE.DataTexture {
  const width = 256;
  const texels = new Uint8Array(4 * width);
  for (let i = 0; i < width; ++i) {
    const place = (i / (width - 1)) * (kMapColors.length - 1);
    const below = Math.min(Math.floor(place), kMapColors.length - 2);
    const share = place - below;
    for (let channel = 0; channel < 3; ++channel) {
      const shift = 16 - 8 * channel;
      const low = (kMapColors[below] >> shift) & 255;
      const high = (kMapColors[below + 1] >> shift) & 255;
      texels[4 * i + channel] = Math.round(low + share * (high - low));
    }
    texels[4 * i + 3] = 255;
  }
  const texture = new THREE.DataTexture(texels, width, 1);
  texture.colorSpace = THREE.SRGBColorSpace;
  texture.magFilter = THREE.LinearFilter;
  texture.minFilter = THREE.LinearFilter;
  texture.needsUpdate = true;
  return texture;
}

/**
 * Woven cloth: another shade on the back, and valleys slightly darker than ridges (attribute `curvature`,
 * 1/m), which is what makes fine wrinkles readable under soft light.
 */
export function clothMaterial(): THREE.Material {
  const material = new THREE.MeshStandardMaterial({
    color: 0xffffff,
    roughness: 0.86,
    metalness: 0,
    side: THREE.DoubleSide,
    shadowSide: THREE.DoubleSide,
  });
  const front = new THREE.Color(0xa85a47);
  const back = new THREE.Color(0x8a5b50);
  material.onBeforeCompile = (shader) => {
    shader.uniforms.uFront = { value: front };
    shader.uniforms.uBack = { value: back };
    shader.vertexShader = shader.vertexShader
      .replace("#include <common>", "#include <common>\nattribute float curvature;\nvarying float vCurvature;")
      .replace("#include <begin_vertex>", "#include <begin_vertex>\nvCurvature = curvature;");
    shader.fragmentShader = shader.fragmentShader
      .replace("#include <common>", "#include <common>\nuniform vec3 uFront;\nuniform vec3 uBack;\nvarying float vCurvature;")
      .replace(
        "#include <color_fragment>",
        `#include <color_fragment>
        float facing = gl_FrontFacing ? 1.0 : -1.0;
        float valley = tanh(vCurvature * facing * 0.03);
        diffuseColor.rgb *= (gl_FrontFacing ? uFront : uBack) * (1.0 - (valley > 0.0 ? 0.34 : 0.18) * valley);`,
      );
  };
  return material;
}

/** The same lighting, softer, with the colour of the attribute `value` in [0, 1]. */
export function mapMaterial(): THREE.Material {
  const material = new THREE.MeshStandardMaterial({
    color: 0xffffff,
    roughness: 1,
    metalness: 0,
    side: THREE.DoubleSide,
    shadowSide: THREE.DoubleSide,
    toneMapped: false,
  });
  const texture = mapTexture();
  material.onBeforeCompile = (shader) => {
    shader.uniforms.uMap = { value: texture };
    shader.vertexShader = shader.vertexShader
      .replace("#include <common>", "#include <common>\nattribute float value;\nvarying float vValue;")
      .replace("#include <begin_vertex>", "#include <begin_vertex>\nvValue = value;");
    shader.fragmentShader = shader.fragmentShader
      .replace("#include <common>", "#include <common>\nuniform sampler2D uMap;\nvarying float vValue;")
      .replace(
        "#include <color_fragment>",
        `#include <color_fragment>
        diffuseColor.rgb *= texture2D(uMap, vec2(clamp(vValue, 0.002, 0.998), 0.5)).rgb;`,
      )
      // Colours must be readable against the legend: most of the light is even, the rest shows the shape.
      .replace(
        "#include <opaque_fragment>",
        `outgoingLight = mix(diffuseColor.rgb, outgoingLight, 0.45);
        #include <opaque_fragment>`,
      );
  };
  return material;
}
