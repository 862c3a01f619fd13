// Clients that others' programs generate from server/openapi.json, without a correction by hand, against the binary.

import assert from 'node:assert/strict'
import { execFile, spawn } from 'node:child_process'
import { once } from 'node:events'
import { cp, mkdtemp, rm, writeFile } from 'node:fs/promises'
import { createServer } from 'node:net'
import { join } from 'node:path'
import { setTimeout as pause } from 'node:timers/promises'
import { after, before, test } from 'node:test'
import { promisify } from 'node:util'

const here = new URL('.', import.meta.url).pathname
const root = join(here, '../..')
const binary = process.env.ISOPEEL_BINARY ?? join(root, 'target/release/isopeel')
const python = process.env.CLIENTS_PYTHON ?? join(root, 'target/clients-venv/bin')
const description = join(root, 'server/openapi.json')
const run = promisify(execFile)
// Of the demo, which is embedded.
const volume = 'mni152'

let folder, server, url
before(async () => {
  folder = await mkdtemp(join(here, '.generated-'))
  const free = createServer().listen(0, '127.0.0.1')
  await once(free, 'listening')
  const { port } = free.address()
  free.close()
  await once(free, 'close')
  url = `http://127.0.0.1:${port}`
  const options = ['serve', '--no-auth', '--listen', `127.0.0.1:${port}`, '--state-folder', join(folder, 'state'), '--uploads', join(folder, 'uploads')]
  server = spawn(binary, options, { stdio: ['ignore', 'ignore', 'inherit'] })
  for (let tries = 0; ; tries += 1) {
    assert.equal(server.exitCode, null, 'the server ended before it was ready')
    assert.ok(tries < 600, 'the server was not ready within 60 s')
    const answer = await fetch(`${url}/readyz`).catch(() => undefined)
    if (answer?.ok) break
    await pause(100)
  }
})
after(async () => {
  server?.kill()
  await rm(folder, { recursive: true, force: true })
})

test('a generated TypeScript client extracts, submits, follows and fetches', async () => {
  const tool = (name, ...options) => run(join(here, 'node_modules/.bin', name), options, { cwd: folder })
  await tool('openapi-typescript', description, '-o', join(folder, 'api.d.ts'))
  await cp(join(here, 'client.ts'), join(folder, 'client.ts'))
  await writeFile(join(folder, 'package.json'), '{"type":"module"}')
  const options = ['--strict', '--target', 'es2022', '--module', 'nodenext', '--skipLibCheck', '--types', 'node', '--typeRoots', join(here, 'node_modules/@types')]
  await tool('tsc', ...options, 'client.ts').catch(({ stdout }) => assert.fail(stdout))
  const { stdout } = await run(process.execPath, [join(folder, 'client.js'), url, volume])
  assert.ok(Number(stdout) > 100, stdout)
})

test('a generated Python client extracts, submits, follows and fetches', async () => {
  await run(join(python, 'openapi-spec-validator'), [description])
  const options = ['--path', description, '--meta', 'none', '--output-path', join(folder, 'isopeel_client'), '--config', join(here, 'python-client.yaml')]
  const { stdout: said } = await run(join(python, 'openapi-python-client'), ['generate', ...options])
  assert.ok(!said.includes('will not be generated'), said)
  const { stdout } = await run(join(python, 'python'), [join(here, 'client.py'), folder, url, volume])
  assert.ok(Number(stdout) > 100, stdout)
})
