#!/bin/bash
pkill -STOP -f "studies placement|serve\(\)"
rm -rf /root/fc7; mkdir /root/fc7; git clone -q /work/main /root/fc7/perdure; cd /root/fc7/perdure
unset PYTHONPATH
echo -9 > /proc/self/autogroup
{ time make setup; } > /root/fc-setup.log 2>&1
{ time make demo; } > /root/fc-demo.log 2>&1; echo "demo rc $?" >> /root/fc-demo.log
{ time make test; } > /root/fc-test.log 2>&1; echo "test rc $?" >> /root/fc-test.log
pkill -CONT -f "studies placement|serve\(\)"
touch /root/fc-done
