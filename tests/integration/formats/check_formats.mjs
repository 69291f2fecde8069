// What others say of our exports, as JSON: node check_formats.mjs FILE.glb FILE.usdz, beside node_modules.
import fs from 'node:fs'
import { createRequire } from 'node:module'
import path from 'node:path'

const [gltf, usdz] = process.argv.slice(2)
const modules = path.join(path.dirname(new URL(import.meta.url).pathname), 'node_modules')
const require = createRequire(import.meta.url)

const report = await require('gltf-validator').validateBytes(new Uint8Array(fs.readFileSync(gltf)))

// tinyusdz is compiled for pages: it must not see that this is none.
process.type = 'renderer'
globalThis.window = globalThis
const { default: load } = await import(path.join(modules, 'tinyusdz/tinyusdz.js'))
const native = await load({ wasmBinary: fs.readFileSync(path.join(modules, 'tinyusdz/tinyusdz.wasm')) })
const reader = new native.TinyUSDZLoaderNative()
const read = reader.loadFromBinary(new Uint8Array(fs.readFileSync(usdz)), usdz)
const mesh = read && reader.numMeshes() > 0 ? reader.getMesh(0) : undefined

console.log(JSON.stringify({
  gltf: { issues: report.issues, info: report.info },
  usdz: { read, error: reader.error(), meshes: read ? reader.numMeshes() : 0,
          points: mesh ? mesh.points.length / 3 : 0, corners: mesh ? mesh.faceVertexIndices.length : 0 },
}))
