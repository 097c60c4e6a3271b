# Try an installed command: film a tenth of a second, read it by each receiver, and show the demonstration.
# sh -e scripts/try_wheel.sh COMMAND, in a folder that may be written to
unset PYTHONPATH
command=$1
short="--set channel.duration_s=0.12 --set channel.distance_m=50 --set channel.camera.height=256"

says() {
    grep --quiet "$1" said.txt || { echo "the command did not say: $1"; cat said.txt; exit 1; }
}

$command --version
$command simulate drive.mkv $short
for receiver in plain soft; do
    $command receive drive.mkv --receiver $receiver --truth drive.mkv.truth.npz > said.txt
    says "array 0: 1 packet"
    says "high   1 codeword read, 0 not"
done
$command serve > said.txt 2>&1 || true
says "pip install 'heliograph\[web\]'"
$command demo --output demo $short > said.txt
says "array 0: 1 packet"
test -s demo/report.html
