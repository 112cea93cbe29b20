//! What `--help` teaches by examples, and the exit codes.

pub(crate) const EXIT_CODES: &str = "\
Exit codes:
  0    done; the picture, if one was asked for, is complete
  1    failed; the message says why, and files are as they were before
  2    the command line cannot be understood
  3    the job failed
  4    the job was cancelled
  5    no coordinator answers
  6    the farm refuses: no such job, a limit, a token without the right
  130  interrupted by Ctrl-C; files are as they were before, and `render` keeps what it has in
       OUT.partial.exr and OUT.partial.farm";

pub(crate) const RENDER: &str = "\
Examples:
  photonfarm render scene.xml -o image.exr
      Renders with the scene's own integrator (pcf where it names none of ours)
      and writes image.exr and image.png.
  photonfarm render scene.xml -o image.exr --integrator pppm --iterations 256
      More iterations: less noise and less blur.
  photonfarm render scene.xml -o image.exr --integrator pcf --set photons=1000000 --set theta1=10
      More light paths per iteration, and a narrower first angle.
  photonfarm render scene.xml -o small.exr -D width=320 -D height=240
      Gives values to the scene's <default> parameters.
  photonfarm render scene.xml -o again.exr --from image.exr
      Repeats a picture, bit for bit, with the settings that it names.
  photonfarm render scene.xml -o image.exr --layer albedo --layer 'caustic=L S+ D E' --layer lamp:key
      Layers for a compositor in the same file: what is seen first, caustics, the light of a lamp.
  photonfarm render scene.xml --sensor floor -o lux.csv
      Writes what a meter measures as a table: of a grid on a rectangle a line for each place.
  photonfarm render scene.xml -o image.exr
      Goes on, where the same command was interrupted or killed before: image.partial.farm holds what
      it needs, and goes when the picture is complete. Another scene or other settings begin anew.
  photonfarm render scene.xml -o image.exr --from image.partial.exr
      Goes on likewise, with the settings that the partial picture of an interrupted render names.
  photonfarm render scene.xml -o image.exr --iterations 4096 --noise-target 0.02
      Stops once the noise is low enough; --within 10m stops when the time is up.

image.exr holds linear Rec. 709 radiance in 32-bit floats, a rough standard error of the luminance
in the channel `standard_error`, and everything that repeats the render in its attributes. Noise is
the mean of these errors over the mean luminance, but for the worst hundredth of the pixels.
image.png is for looking at: exposure and highlights follow the global operator of Reinhard et al.
(2002).
The same scene, settings and seed give the same image.exr on any machine, with any --threads.";

pub(crate) const CHECK: &str = "\
Examples:
  photonfarm check scene.xml
      Format, picture size, shapes, lights, materials, textures, bounds; the integrator and the
      settings that `render` would take; warnings; the files that a farm would be sent.
  photonfarm check scene.pbrt --strict
      Fails where anything is left out or replaced.
  photonfarm check scene.xml -v
      Lists also what is accepted and changes nothing in the picture.
  photonfarm check scene.glb --json
      The same for programs; a scene that cannot be loaded gives its errors in `errors`.";

pub(crate) const SUBMIT: &str = "\
Examples:
  photonfarm submit scene.xml --coordinator http://127.0.0.1:7800 --iterations 256 --wait -o image.exr
      Sends the scene to the farm, shows progress, and fetches image.exr and image.png.
  photonfarm submit scene.xml --coordinator http://127.0.0.1:7800
      Prints the number of the job and leaves.
  photonfarm wait 7 --coordinator http://127.0.0.1:7800 -o image.exr
      Waits for job 7, whoever submitted it and however long ago, and fetches its picture.
  photonfarm submit scene.xml --key \"nightly $(date +%F)\" --wait -o image.exr
      For scripts that may be run again: the first run of the day makes a job, later ones take it up.

  photonfarm submit kitchen.zip --label shot=3 --label draft=yes
      Sends the one scene in an archive (zip, tar, tar.gz) or a folder; `jobs --label shot=3` finds it.
  photonfarm submit arm.glb --frames 1..24 --wait -o arm.exr
      A job for each frame, and the pictures arm.0001.exr to arm.0024.exr.
  photonfarm submit beauty.xml --after 7
      Begins once job 7 is done, and is cancelled where that fails or is cancelled.
  generate | photonfarm submit - --format pbrt
      Sends a scene from standard input, which may name files of the current folder.

The scene file and every file that it names are sent; what the farm has already is not sent again.
They may lie anywhere on this machine. --wait goes on through restarts of the
coordinator. Interrupting it leaves the job running on the farm, and says how to go on waiting. Each
submission makes a new job, the same scene and settings as well, unless --key says that it is the same
submission: then the scene and all settings must be the same, and the job may have ended since.";

pub(crate) const SERVE: &str = "\
Examples:
  photonfarm serve --listen 127.0.0.1:7800 --data farm
  photonfarm-worker --coordinator http://127.0.0.1:7800
  photonfarm submit scene.xml --coordinator http://127.0.0.1:7800 --wait -o image.exr

Everything that the coordinator knows lies in the data folder: stop it or kill it, start it again
with the same folder, and its jobs go on. Port 0 takes a free port; the first line on
standard output says which. RUST_LOG sets how much is logged (warn, info, debug,
photonfarm_coordinator=trace, ...).

--state and --blobs keep jobs and bytes elsewhere; several coordinators share a farm by the same ones.
For s3:// the usual variables AWS_ENDPOINT, AWS_REGION, AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY apply:
  photonfarm serve --listen 127.0.0.1:7800 --state postgres://farm:PASSWORD@db/farm --blobs s3://renders/farm

A farm without any token is open to whoever can connect, so it listens on this machine only. Once
there is one, every request needs one. To listen for other machines:
  photonfarm token create boss --role admin --data farm > boss.token
  photonfarm serve --listen 0.0.0.0:7800 --data farm --tls-cert farm.pem --tls-key farm.key";

pub(crate) const BACKUP: &str = "\
Examples:
  photonfarm backup --data farm /backup/farm-$(date +%F)
      Saves the farm as it stands at an instant while the command runs.
  photonfarm serve --listen 127.0.0.1:7800 --data /backup/farm-2026-11-27
      Serves what was saved; or copy it to where the farm was, while that is stopped.

A farm that was restored notices, and numbers new jobs beyond all that it can have given since the
backup. Jobs in PostgreSQL are saved by PostgreSQL's own means: see docs/FARM.md.";

pub(crate) const TOKEN: &str = "\
Examples:
  photonfarm token create boss --role admin --data farm > boss.token
      Makes the first token of a farm that is not running, on its data folder.
  export PHOTONFARM_COORDINATOR=https://farm.example:7800 PHOTONFARM_TOKEN_FILE=boss.token
  photonfarm token create rack --role worker > rack.token
  photonfarm token create ann --role submit --days 90 --most-jobs 20 --most-gigabytes 50 > ann.token
  photonfarm token list
  photonfarm token revoke ann
      Makes, lists and revokes tokens of a running farm.

Roles: read looks at everything; submit also sends scenes and jobs, and steers its own jobs; worker
renders and sees nothing but the files of scenes; admin does everything. The token goes to standard
output, once: the farm keeps only its hash. Jobs of a revoked token go on.";

pub(crate) const COMPLETIONS: &str = "\
Examples:
  photonfarm completions bash > ~/.local/share/bash-completion/completions/photonfarm
  photonfarm completions zsh > ~/.zfunc/_photonfarm
  photonfarm completions fish > ~/.config/fish/completions/photonfarm.fish";

pub(crate) const JOBS: &str = "\
Examples:
  photonfarm jobs
      The newest 20 jobs: what goes on, how long it takes, and why something does not.
  photonfarm jobs --state running --sort left
      Those that workers are at, the longest first.
  photonfarm jobs --watch
      Again and again, as `top` does.
  photonfarm jobs 7
      Job 7 with its warnings and failures.
  photonfarm jobs --json --limit 1000 | jq '.[] | select(.state == \"failed\") | .id'
      For scripts.";

pub(crate) const WORKERS: &str = "\
Examples:
  photonfarm workers
      Who is there: state, jobs, speed, build, and who is in quarantine.
  photonfarm workers --json | jq '.[] | select(.leases == 0) | .name'
      Who has nothing to do.
  photonfarm workers quarantine 3 --reason 'bad memory'
  photonfarm workers release 3";

pub(crate) const DRAIN: &str = "\
Examples:
  photonfarm drain 3
      Worker 3 finishes what it holds and gets no more: its machine can be switched off then.
  photonfarm workers
      Whether it still holds something.
  photonfarm drain 3 --undo";
