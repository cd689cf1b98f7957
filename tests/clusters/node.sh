#!/bin/bash
# The first process of a node of the bed: makes its file system, network and user, and becomes its sshd.
#
#     node.sh FOLDER NAME "ADDRESS [PUBLIC ADDRESS]" [KIND:PATH ...]
#
# FOLDER keeps what the node writes. Each PATH is seen where this machine has it: "read" as it is, "write" to be
# changed, "own" with changes that stay the node's. What else the node sees is this machine's system, with changes of its own.
set -euo pipefail
folder=$1 name=$2
read -r address public <<<"$3"
shift 3
root=$folder/root
mkdir -p "$root"
mount --make-rprivate /
mount --bind "$root" "$root"

own() { # a folder of this machine, with changes of the node's
    local layers
    layers=$folder/layers/$(tr / - <<<"${1#/}")
    mkdir -p "$layers/changes" "$layers/work" "$root$1"
    mount -t overlay overlay -o "lowerdir=$1,upperdir=$layers/changes,workdir=$layers/work" "$root$1"
}
for each in /usr /etc /var; do own "$each"; done
for each in /bin /sbin /lib /lib64; do [[ -e $root$each ]] || cp -P "$each" "$root$each"; done
mkdir -p "$root"/{dev,home,mnt,opt,proc,root,run,shared,sys,tmp}
chmod 1777 "$root/tmp"
chmod 755 "$root/root"
for each in "$@"; do
    path=${each#*:}
    mkdir -p "$root$path"
    case $each in
        own:*) own "$path" ;;
        write:*) mount --bind "$path" "$root$path" ;;
        read:*) mount --bind "$path" "$root$path" && mount -o remount,bind,ro "$root$path" ;;
    esac
done
mount --bind "$folder/../shared" "$root/shared"

mount -t proc proc "$root/proc"
mount -t sysfs sysfs "$root/sys"
mount -t tmpfs tmpfs "$root/run"
mount -t tmpfs tmpfs "$root/dev"
for each in full null random tty urandom zero; do
    touch "$root/dev/$each"
    mount --bind "/dev/$each" "$root/dev/$each"
done
mkdir "$root"/dev/{pts,shm} "$root/run/sshd"
mount -t tmpfs tmpfs "$root/dev/shm"
mount -t devpts -o newinstance,ptmxmode=0666 devpts "$root/dev/pts"
ln -s pts/ptmx "$root/dev/ptmx"
ln -s /proc/self/fd "$root/dev/fd"

# /proc is still that of the switch, whose first process is 1.
ip link add eth0 type veth peer name "${name:0:15}" netns /proc/1/ns/net
nsenter --net=/proc/1/ns/net ip link set "${name:0:15}" master bridge up
# The same one after a restart: neighbours remember it for a minute.
ip link set eth0 address "$(printf '02:00:%02x:%02x:%02x:%02x' ${address//./ })"
ip address add "$address/24" dev eth0
[[ -z $public ]] || ip address add "$public/32" dev eth0
ip link set eth0 up
ip route add default dev eth0 # everybody is on the bridge
ip link set lo up
hostname "$name"

cd "$root"
pivot_root . .
umount -l .
cd /
echo "$name" >/etc/hostname
cp /shared/.bed/hosts /etc/hosts
grep -q " $name\$" /etc/hosts || echo "$address $name" >>/etc/hosts
rm -f /etc/nologin
id ubuntu &>/dev/null || useradd --create-home --shell /bin/bash --password '*' ubuntu
for home in /root /home/ubuntu; do
    install -d -m 700 "$home/.ssh"
    install -m 600 /shared/.bed/key "$home/.ssh/id_ed25519"
    install -m 600 /shared/.bed/key.pub "$home/.ssh/authorized_keys"
done
chown -R ubuntu: /home/ubuntu/.ssh
# What a minimal image may lack: its user is allowed all.
[[ -x /usr/bin/sudo ]] || { printf '#!/bin/sh\nexec /usr/bin/ssh -qo StrictHostKeyChecking=no root@localhost "$@"\n' >/usr/bin/sudo; chmod 755 /usr/bin/sudo; }
exec /usr/sbin/sshd -D -e -o UsePAM=no -o MaxStartups=100 -o UseDNS=no -o PermitUserEnvironment=yes
