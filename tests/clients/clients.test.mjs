// Clients that others' programs generate from server/openapi.json, without a correction by hand, against the binary.

import assert from 'node:assert/strict'
import { execFile, spawn } from 'node:child_process'
import { randomBytes } from 'node:crypto'
import { once } from 'node:events'
import { cp, mkdtemp, readFile, rm, writeFile } from 'node:fs/promises'
import { createServer } from 'node:net'
import { join } from 'node:path'
import { setTimeout as pause } from 'node:timers/promises'
import { after, before, test } from 'node:test'
import { promisify } from 'node:util'
import { startIssuer } from './issuer.mjs'

const here = new URL('.', import.meta.url).pathname
const root = join(here, '../..')
const binary = process.env.ISOPEEL_BINARY ?? join(root, 'target/release/isopeel')
const python = process.env.CLIENTS_PYTHON ?? join(root, 'target/clients-venv/bin')
const description = join(root, 'server/openapi.json')
const run = promisify(execFile)
// Of the demo, which is embedded.
const volume = 'mni152'
const token = randomBytes(32).toString('hex')

let folder, issuer, server, url
before(async () => {
  folder = await mkdtemp(join(here, '.generated-'))
  await writeFile(join(folder, 'token'), token, { mode: 0o600 })
  issuer = await startIssuer('isopeel')
  const free = createServer().listen(0, '127.0.0.1')
  await once(free, 'listening')
  const { port } = free.address()
  free.close()
  await once(free, 'close')
  url = `http://127.0.0.1:${port}`
  const signIn = ['--public-url', url, '--oidc-issuer', issuer.issuer, '--oidc-client-id', 'isopeel', '--oidc-role', '*=view']
  const folders = ['--state-folder', join(folder, 'state'), '--uploads', join(folder, 'uploads'), '--token-file', join(folder, 'token')]
  server = spawn(binary, ['serve', '--listen', `127.0.0.1:${port}`, ...folders, ...signIn], { stdio: ['ignore', 'ignore', 'inherit'] })
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
  issuer?.server.close()
  await rm(folder, { recursive: true, force: true })
})

/** A module that compiles only if each operation that answers with a body has a type for it, and all have one for problems. */
async function typed() {
  const { paths } = JSON.parse(await readFile(description, 'utf8'))
  const operations = Object.values(paths).flatMap(item => Object.values(item).filter(({ operationId }) => operationId !== undefined))
  const hasBody = ({ responses }) => Object.entries(responses).some(([status, { content }]) => status < '300' && content !== undefined)
  const line = operation => {
    const id = `'${operation.operationId}'`
    const body = hasBody(operation) ? `\nexport const ${operation.operationId}: IsTyped<Body<${id}>> = true` : ''
    const problem = '401' in operation.responses ? `\nexport const ${operation.operationId}_problem: Problem<${id}>['code'] extends string ? true : false = true` : ''
    return body + problem
  }
  assert.ok(operations.length > 30, `${operations.length} operations`)
  return `import type { operations } from './api.js'
type Responses<O extends keyof operations> = operations[O]['responses']
type Content<R> = R extends { content: infer C } ? C[keyof C] : never
type Body<O extends keyof operations> = { [S in keyof Responses<O>]: S extends 200 | 201 ? Content<Responses<O>[S]> : never }[keyof Responses<O>]
type Problem<O extends keyof operations> = Responses<O> extends { 401: { content: { 'application/problem+json': infer P } } } ? P : never
type IsTyped<T> = [T] extends [never] ? false : unknown extends T ? false : true
${operations.map(line).join('')}
`
}

test('a generated TypeScript client uses every operation, and knows the types of answers', async () => {
  const tool = (name, ...options) => run(join(here, 'node_modules/.bin', name), options, { cwd: folder })
  await tool('openapi-typescript', description, '-o', join(folder, 'api.d.ts'))
  await cp(join(here, 'client.ts'), join(folder, 'client.ts'))
  await writeFile(join(folder, 'typed.ts'), await typed())
  await writeFile(join(folder, 'package.json'), '{"type":"module"}')
  const options = ['--strict', '--target', 'es2022', '--module', 'nodenext', '--skipLibCheck', '--types', 'node', '--typeRoots', join(here, 'node_modules/@types')]
  await tool('tsc', ...options, 'client.ts', 'typed.ts').catch(({ stdout }) => assert.fail(stdout))
  const { stdout } = await run(process.execPath, [join(folder, 'client.js'), url, volume, token, description])
  assert.ok(Number(stdout) > 100, stdout)
})

test('a generated Python client uses every operation, and knows the types of answers', async () => {
  await run(join(python, 'openapi-spec-validator'), [description])
  const options = ['--path', description, '--meta', 'none', '--output-path', join(folder, 'isopeel_client'), '--config', join(here, 'python-client.yaml')]
  const { stdout: said } = await run(join(python, 'openapi-python-client'), ['generate', ...options])
  assert.ok(!said.includes('will not be generated'), said)
  const { stdout } = await run(join(python, 'python'), [join(here, 'client.py'), folder, url, volume, token, description])
  assert.ok(Number(stdout) > 100, stdout)
})
