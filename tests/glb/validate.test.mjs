// GLB files of the release binary, by command and by REST, in the Khronos validator: no error, no warning, and the
// triangles that `--stats` counts.

import assert from 'node:assert/strict'
import { execFile, spawn } from 'node:child_process'
import { once } from 'node:events'
import { mkdtemp, readFile, rm } from 'node:fs/promises'
import { createServer } from 'node:net'
import { tmpdir } from 'node:os'
import { join } from 'node:path'
import { setTimeout as pause } from 'node:timers/promises'
import { after, before, test } from 'node:test'
import { promisify } from 'node:util'
import validator from 'gltf-validator'

const root = new URL('../../', import.meta.url).pathname
const binary = process.env.ISOPEEL_BINARY ?? join(root, 'target/release/isopeel')
const volume = join(root, 'server/demo/t1.nii.gz')
const run = promisify(execFile)

let folder
before(async () => {
  folder = await mkdtemp(join(tmpdir(), 'isopeel-glb-'))
})
after(() => rm(folder, { recursive: true }))

/** Validates a GLB; returns how many triangles it draws. */
async function trianglesOfValid(bytes) {
  const report = await validator.validateBytes(new Uint8Array(bytes), { maxIssues: 20 })
  const { numErrors, numWarnings, messages } = report.issues
  assert.equal(numErrors, 0, JSON.stringify(messages, null, 1))
  assert.equal(numWarnings, 0, JSON.stringify(messages, null, 1))
  return report.info.totalTriangleCount
}

/** A port that was free a moment ago: the only way to know one before the server prints it. */
async function freePort() {
  const server = createServer().listen(0, '127.0.0.1')
  await once(server, 'listening')
  const { port } = server.address()
  server.close()
  await once(server, 'close')
  return port
}

async function ready(url, server) {
  for (let tries = 0; tries < 600; tries++) {
    assert.equal(server.exitCode, null, 'the server ended before it was ready')
    const answer = await fetch(`${url}/readyz`).catch(() => undefined)
    if (answer?.ok) return
    await pause(100)
  }
  assert.fail('the server was not ready within 60 s')
}

test('several surfaces are nodes of one valid GLB', async () => {
  const path = join(folder, 'several.glb')
  const surfaces = ['{"name":"skin","iso":60,"color":"#d2b48c","opacity":0.4}', '{"iso":110}']
  const named = surfaces.flatMap((surface) => ['--surface', surface])
  const { stdout } = await run(binary, ['extract', volume, '--error', '0.3vx', ...named, '-o', path, '--stats'])
  assert.equal(await trianglesOfValid(await readFile(path)), JSON.parse(stdout).triangles)
})

for (const beta of ['-1', '0.02', '0.1']) {
  test(`extract at beta ${beta} writes a valid GLB`, async () => {
    const path = join(folder, `beta${beta}.glb`)
    const { stdout } = await run(binary, ['extract', volume, '--iso', '100', `--beta=${beta}`, '-o', path, '--stats'])
    const { triangles } = JSON.parse(stdout)
    assert.ok(triangles > 0)
    assert.equal(await trianglesOfValid(await readFile(path)), triangles)
  })
}

test('POST extract answers a valid GLB, the same surface as the command writes', async () => {
  const port = await freePort()
  const url = `http://127.0.0.1:${port}`
  const server = spawn(binary, ['serve', '--no-auth', '--listen', `127.0.0.1:${port}`], { stdio: ['ignore', 'ignore', 'inherit'] })
  try {
    await ready(url, server)
    const [{ id }] = await fetch(`${url}/api/v1/volumes`).then((answer) => answer.json())
    const edit = { field: 't1', feature: 'none', iso: 100, alpha: 0, beta: 0.02, maxLevel: 5 }
    const identity = [0, 1].map((x) => ({ x, importance: x, color: '#ffffff' }))
    const answer = await fetch(`${url}/api/v1/extract`, {
      method: 'POST',
      headers: { 'content-type': 'application/json' },
      body: JSON.stringify({ volume: id, format: 'glb', ...edit, transferFunction: { points: identity } }),
    })
    assert.equal(answer.status, 200, await answer.clone().text())
    const path = join(folder, 'same.glb')
    const { stdout } = await run(binary, ['extract', volume, '--iso', '100', '--beta', '0.02', '-o', path, '--stats'])
    assert.equal(await trianglesOfValid(await answer.arrayBuffer()), JSON.parse(stdout).triangles)
  } finally {
    server.kill('SIGTERM')
    if (server.exitCode === null && server.signalCode === null) await once(server, 'exit')
  }
})
